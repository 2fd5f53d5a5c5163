/* Voxel-driven back-projection of filtered projections: volume += sum over views of image(u, v) / depth^2.

   One work-item a voxel: ids are (x, y, z) indices, z within the slab.
   images:   (views, ROWS + 2, COLUMNS + 2) float32 with a border of zeros one pixel wide, so that a voxel outside the detector reads 0;
             two more rows of zeros follow the last view, since the last corner reads its neighbors too
   matrices: (views, 12) float32, row by row: voxel index (x, y, z of the slab, 1) to (u depth, v depth, depth), u and v in pixels of
             the bordered image, depth in metres
   volume:   (NZ, NY, NX) float32, accumulated. */

__kernel void backproject_voxels(__global const float *images, __constant float *matrices, const int views, __global float *volume,
                                 const int nx, const int ny)
{
    const int x = get_global_id(0), y = get_global_id(1), z = get_global_id(2);
    const float fx = x, fy = y, fz = z;
    float sum = 0.0f;
    for (int k = 0; k < views; ++k) {
        __constant float *m = matrices + 12 * k;
        const float depth = m[8] * fx + m[9] * fy + m[10] * fz + m[11];
        const float inverse = depth > 1e-6f ? 1.0f / depth : 0.0f;
        const float u = clamp((m[0] * fx + m[1] * fy + m[2] * fz + m[3]) * inverse, 0.0f, (float)(COLUMNS + 1));
        const float v = clamp((m[4] * fx + m[5] * fy + m[6] * fz + m[7]) * inverse, 0.0f, (float)(ROWS + 1));
        const int i = (int)u, j = (int)v;
        const float du = u - i, dv = v - j;
        __global const float *pixel = images + ((long)k * (ROWS + 2) + j) * (COLUMNS + 2) + i;
        const float low = pixel[0] + du * (pixel[1] - pixel[0]);
        const float high = pixel[COLUMNS + 2] + du * (pixel[COLUMNS + 3] - pixel[COLUMNS + 2]);
        sum += (low + dv * (high - low)) * inverse * inverse;
    }
    volume[((long)z * ny + y) * nx + x] += sum;
}
