/* Derivative of backproject_voxels (backproject.cl goes before this file) with respect to where voxels fall in the views.

   A voxel x adds slope(x) image(u, v) / depth^2 to the criterion, and the pixels are h = (u depth, v depth, depth). For a block of voxels and a
   view this kernel sums dE/dh, multiplied by powers of the voxel's place in the block: what depends linearly (matrices) or trilinearly
   (displacements at nodes) on that place follows from such moments. A work-item has one view and one block: neighboring items share the
   voxel, and no sum crosses work-items, so that the digits do not depend on the device's number of units.

   ids:     (view, block)
   slopes:  (nz, ny, nx) dE/dV in the order of steps: elements between voxels along c, b, a
   blocks:  (blocks, 6): first voxel and end along c, b, a
   moments: (blocks, MOMENTS, 3, views): dE/dh times 1, c, b, cb, a, ca, ba, cba, counted from the block's first voxel; the first MOMENTS
            of these, 5 or 8 */

inline float3 slope_of_pixel(__global const float *image, const float3 h)
{
    const float inverse = h.z > 1e-6f ? 1.0f / h.z : 0.0f;
    const float u = h.x * inverse, v = h.y * inverse;
    const int seen = inverse > 0.0f && u > -1.0f && u < (float)COLUMNS && v > -1.0f && v < (float)ROWS;
    const float at_u = seen ? u : 0.0f, at_v = seen ? v : 0.0f;
    const float left = floor(at_u), low = floor(at_v), du = at_u - left, dv = at_v - low;
    __global const float *pixel = image + ((int)left + PAD) * STRIDE + LEAD + (int)low;
    const float p00 = pixel[0], p01 = pixel[1], p10 = pixel[STRIDE], p11 = pixel[STRIDE + 1];
    const float here = p00 + dv * (p01 - p00), beside = p10 + dv * (p11 - p10);
    const float by_u = beside - here, by_v = p01 - p00 + du * (p11 - p10 - (p01 - p00)), value = here + du * by_u;
    const float cube = seen ? inverse * inverse * inverse : 0.0f;
    return cube * (float3)(by_u, by_v, -(by_u * at_u + by_v * at_v + 2.0f * value));
}

__kernel void image_gradient(__global const float *images, PLACE, __global const float *grid, __constant const float *rest,
                             __global const float *field, const int first, __global const float *slopes, const long4 steps,
                             __global const int *blocks, __global float *moments)
{
    const int k = get_global_id(0), views = get_global_size(0);
    __global const int *block = blocks + 6 * get_global_id(1);
    __global const float *image = images + (size_t)(first + k) * (COLUMNS + 2 * PAD) * STRIDE;
    float3 sums[8];
    for (int m = 0; m < 8; ++m) sums[m] = 0.0f;
    for (int a = block[4]; a < block[5]; ++a)
        for (int b = block[2]; b < block[3]; ++b) {
            float3 plain = 0.0f, along = 0.0f;
            for (int c = block[0]; c < block[1]; ++c) {
                const float slope = slopes[c * steps.x + b * steps.y + a * steps.z];
                if (slope == 0.0f) continue;
                const float3 h = homogeneous_at(point_at(c, b, a, grid, rest), k, place, rest, field);
                const float3 found = slope * slope_of_pixel(image, h);
                plain += found;
                along += (float)(c - block[0]) * found;
            }
            const float across = b - block[2], up = a - block[4];
            sums[0] += plain, sums[1] += along, sums[2] += across * plain, sums[4] += up * plain;
#if MOMENTS == 8
            sums[3] += across * along, sums[5] += up * along, sums[6] += up * across * plain, sums[7] += up * across * along;
#endif
        }
    __global float *out = moments + get_global_id(1) * (size_t)(MOMENTS * 3) * views + k;
    for (int m = 0; m < MOMENTS; ++m) {
        out[(3 * m) * views] = sums[m].x;
        out[(3 * m + 1) * views] = sums[m].y;
        out[(3 * m + 2) * views] = sums[m].z;
    }
}
