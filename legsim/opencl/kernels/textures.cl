/* Images read by texture units: for inclusion in other kernels.

   images: (layers, height, width) single-channel float32, read linearly between the pixels' centers, which lie at 0, 1, 2 … along x (width)
           and y (height). Hardware rounds places in a pixel, usually to 1/256 of it. */

__constant sampler_t LINEAR = CLK_NORMALIZED_COORDS_FALSE | CLK_ADDRESS_CLAMP_TO_EDGE | CLK_FILTER_LINEAR;

float read_texture(__read_only image2d_array_t images, const float x, const float y, const int layer)
{
    return read_imagef(images, LINEAR, (float4)(x + 0.5f, y + 0.5f, (float)layer, 0.0f)).x;
}

/* What legsim/opencl/textures.py compares with known numbers. points: (n, 3) x, y, layer; values: (n) */
__kernel void read_points(__read_only image2d_array_t images, __global const float *points, __global float *values)
{
    __global const float *p = points + 3 * get_global_id(0);
    values[get_global_id(0)] = read_texture(images, p[0], p[1], (int)p[2]);
}
