/* Deforms projection images by moving least squares, rigid variant in the plane (Schaefer et al. 2006): corrected(v) = recorded(f(v)).

   One work-item a pixel: ids are (u, v, view within the batch).
   recorded, corrected: (views, ROWS, COLUMNS) float32
   points: (views, COUNT, 4) float32: u and v of each control point at rest, then how far it moved along u and along v, pixels

   f(v) is written as a displacement, so that it is exactly nothing where nothing moved. Read by Keys' cubic convolution (a = -1/2),
   which gives a pixel itself at its center; outside, the border pixels go on. Scalars throughout: CPU compilers vectorize across pixels. */

float keys_near(const float x) { return (1.5f * x - 2.5f) * x * x + 1.0f; }
float keys_far(const float x) { return ((-0.5f * x + 2.5f) * x - 4.0f) * x + 2.0f; }

/* f(v) - v of the pixel at (u, v). */
float2 mls_shift(const float u, const float v, __global const float *points)
{
    float weights[COUNT];
    float total = 0.0f, arm_u = 0.0f, arm_v = 0.0f, shift_u = 0.0f, shift_v = 0.0f;
    for (int j = 0; j < COUNT; ++j) {
        const float du = points[4 * j] - u, dv = points[4 * j + 1] - v;
        /* at a control point the weight is as good as infinite: a millionth of a pixel */
        const float weight = 1.0f / fmax(du * du + dv * dv, 1e-12f);
        weights[j] = weight;
        total += weight;
        arm_u += weight * du;
        arm_v += weight * dv;
        shift_u += weight * points[4 * j + 2];
        shift_v += weight * points[4 * j + 3];
    }
    const float norm = 1.0f / total;
    /* p* - v and q* - p* */
    arm_u *= norm, arm_v *= norm, shift_u *= norm, shift_v *= norm;
    float cosine = 0.0f, sine = 0.0f;
    for (int j = 0; j < COUNT; ++j) {
        const float pu = points[4 * j] - u - arm_u, pv = points[4 * j + 1] - v - arm_v;
        const float extra_u = points[4 * j + 2] - shift_u, extra_v = points[4 * j + 3] - shift_v;
        cosine += weights[j] * (pu * (pu + extra_u) + pv * (pv + extra_v));
        sine += weights[j] * (pu * extra_v - pv * extra_u);
    }
    const float size = sqrt(cosine * cosine + sine * sine);
    const float inverse = size > 1e-20f ? 1.0f / size : 0.0f;
    const float s = sine * inverse, c = cosine * inverse;
    /* 1 - cos without cancellation; no turn at all where the points leave it open */
    const float versine = size > 1e-20f ? (c > 0.0f ? s * s / (1.0f + c) : 1.0f - c) : 0.0f;
    return (float2)(shift_u + versine * arm_u + s * arm_v, shift_v - s * arm_u + versine * arm_v);
}

__kernel void warp_mls(__global const float *recorded, __global const float *points, __global float *corrected)
{
    const int u = get_global_id(0), v = get_global_id(1), view = get_global_id(2);
    const float2 shift = mls_shift((float)u, (float)v, points + view * (4 * COUNT));
    const float x = clamp(u + shift.x, 0.0f, (float)(COLUMNS - 1)), y = clamp(v + shift.y, 0.0f, (float)(ROWS - 1));
    const int i = (int)x, j = (int)y;
    const float a = x - i, b = y - j;
    const float a0 = keys_far(1.0f + a), a1 = keys_near(a), a2 = keys_near(1.0f - a), a3 = keys_far(2.0f - a);
    const float b0 = keys_far(1.0f + b), b1 = keys_near(b), b2 = keys_near(1.0f - b), b3 = keys_far(2.0f - b);
    const int i0 = max(i - 1, 0), i2 = min(i + 1, COLUMNS - 1), i3 = min(i + 2, COLUMNS - 1);
    __global const float *image = recorded + (long)view * (ROWS * COLUMNS);
    __global const float *row0 = image + max(j - 1, 0) * COLUMNS, *row1 = image + j * COLUMNS;
    __global const float *row2 = image + min(j + 1, ROWS - 1) * COLUMNS, *row3 = image + min(j + 2, ROWS - 1) * COLUMNS;
    const float low = b0 * (a0 * row0[i0] + a1 * row0[i] + a2 * row0[i2] + a3 * row0[i3]) +
                      b1 * (a0 * row1[i0] + a1 * row1[i] + a2 * row1[i2] + a3 * row1[i3]);
    const float high = b2 * (a0 * row2[i0] + a1 * row2[i] + a2 * row2[i2] + a3 * row2[i3]) +
                       b3 * (a0 * row3[i0] + a1 * row3[i] + a2 * row3[i2] + a3 * row3[i3]);
    corrected[((long)view * ROWS + v) * COLUMNS + u] = low + high;
}
