/* Total variation of a volume (nz, ny, nx): the sum over voxels of |D f|, D f being forward differences over the spacing, 0 past the last voxel.
   Dual fields are (3, nz, ny, nx): along x, y, z. Global ids are (x, y, z). */

inline size_t voxel_of(void)
{
    return get_global_id(0) + get_global_size(0) * (get_global_id(1) + get_global_size(1) * (size_t)get_global_id(2));
}

inline float3 slope_at(__global const float *volume, const size_t i, const size_t x, const size_t y, const size_t z, const size_t nx,
                       const size_t ny, const size_t nz, const float3 per_spacing)
{
    const float here = volume[i];
    return (float3)(x + 1 < nx ? volume[i + 1] - here : 0.0f, y + 1 < ny ? volume[i + nx] - here : 0.0f,
                    z + 1 < nz ? volume[i + nx * ny] - here : 0.0f) *
           per_spacing;
}

/* nearest = max(volume - scale D^T dual, 0); the dual is 0 past the last voxel of each axis */
__kernel void from_dual(__global const float *volume, __global const float *dual, __global float *nearest, const float4 per_spacing,
                        const float scale)
{
    const size_t i = voxel_of(), nx = get_global_size(0), ny = get_global_size(1), count = nx * ny * get_global_size(2);
    const float across = (dual[i] - (get_global_id(0) ? dual[i - 1] : 0.0f)) * per_spacing.x +
                         (dual[count + i] - (get_global_id(1) ? dual[count + i - nx] : 0.0f)) * per_spacing.y +
                         (dual[2 * count + i] - (get_global_id(2) ? dual[2 * count + i - nx * ny] : 0.0f)) * per_spacing.z;
    nearest[i] = fmax(volume[i] + scale * across, 0.0f);
}

/* A step of the dual: next = (ahead + rate D nearest) kept to length 1; ahead = next + momentum (next - dual); dual = next */
__kernel void climb_dual(__global const float *nearest, __global float *dual, __global float *ahead, const float4 per_spacing, const float rate,
                         const float momentum)
{
    const size_t nx = get_global_size(0), ny = get_global_size(1), nz = get_global_size(2), i = voxel_of(), count = nx * ny * nz;
    const float3 slope = slope_at(nearest, i, get_global_id(0), get_global_id(1), get_global_id(2), nx, ny, nz, per_spacing.xyz);
    float3 next = (float3)(ahead[i], ahead[count + i], ahead[2 * count + i]) + rate * slope;
    next /= fmax(1.0f, length(next));
    for (int axis = 0; axis < 3; ++axis) {
        const float value = axis == 0 ? next.x : axis == 1 ? next.y : next.z;
        ahead[axis * count + i] = value + momentum * (value - dual[axis * count + i]);
        dual[axis * count + i] = value;
    }
}

/* sums[z, y] = the sum along x of |D volume|; global ids are (y, z) */
__kernel void variation(__global const float *volume, __global float *sums, const float4 per_spacing, const int nx)
{
    const size_t y = get_global_id(0), z = get_global_id(1), ny = get_global_size(0), nz = get_global_size(1);
    float sum = 0.0f;
    for (size_t x = 0; x < nx; ++x)
        sum += length(slope_at(volume, x + nx * (y + ny * z), x, y, z, nx, ny, nz, per_spacing.xyz));
    sums[y + ny * z] = sum;
}
