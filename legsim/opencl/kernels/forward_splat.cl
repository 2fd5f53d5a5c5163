/* The adjoint of backproject_voxels (backproject.cl goes before this file): images += the volume's values, spread with the same weights.

   ATOMIC 0: id is the view, which no other work-item writes to: for CPUs. ATOMIC 1: ids are (c, b, a) of a voxel: for GPUs.
   images:   (views, COLUMNS + 2 PAD, STRIDE) as for back-projection; what lands in the border is to be ignored
   volume:   (nz, ny, nx) in the order of steps: elements between voxels along c, b, a
   counts:   voxels along c, b, a */

#if ATOMIC
inline void add_to(__global float *target, const float value)
{
    volatile __global uint *bits = (volatile __global uint *)target;
    uint before = *bits, seen;
    while ((seen = atomic_cmpxchg(bits, before, as_uint(as_float(before) + value))) != before) before = seen;
}
#else
inline void add_to(__global float *target, const float value)
{
    *target += value;
}
#endif

inline void spread_voxel(__global float *image, const float3 h, const float value)
{
    const float inverse = h.z > 1e-6f ? 1.0f / h.z : 0.0f;
    const float u = h.x * inverse, v = h.y * inverse;
    if (!(inverse > 0.0f && u > -1.0f && u < (float)COLUMNS && v > -1.0f && v < (float)ROWS)) return;
    const float left = floor(u), low = floor(v), du = u - left, dv = v - low, weighted = value * inverse * inverse;
    __global float *pixel = image + ((int)left + PAD) * STRIDE + LEAD + (int)low;
    add_to(pixel, weighted * (1.0f - du) * (1.0f - dv));
    add_to(pixel + 1, weighted * (1.0f - du) * dv);
    add_to(pixel + STRIDE, weighted * du * (1.0f - dv));
    add_to(pixel + STRIDE + 1, weighted * du * dv);
}

__kernel void spread_volume(__global float *images, PLACE, __global const float *grid, __constant const float *rest,
                            __global const float *field, const int first, const int views, __global const float *volume, const int4 counts,
                            const long4 steps)
{
    const size_t size = (size_t)(COLUMNS + 2 * PAD) * STRIDE;
#if ATOMIC
    const int c = get_global_id(0), b = get_global_id(1), a = get_global_id(2);
    const float value = volume[c * steps.x + b * steps.y + a * steps.z];
    if (value == 0.0f) return;
    const point_t point = point_at(c, b, a, grid, rest);
    for (int k = 0; k < views; ++k) spread_voxel(images + (first + k) * size, homogeneous_at(point, k, place, rest, field), value);
#else
    const int k = get_global_id(0);
    for (int a = 0; a < counts.z; ++a)
        for (int b = 0; b < counts.y; ++b)
            for (int c = 0; c < counts.x; ++c) {
                const float value = volume[c * steps.x + b * steps.y + a * steps.z];
                if (value == 0.0f) continue;
                spread_voxel(images + (first + k) * size, homogeneous_at(point_at(c, b, a, grid, rest), k, place, rest, field), value);
            }
#endif
}
