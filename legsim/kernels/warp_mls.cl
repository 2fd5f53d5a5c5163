/* Deforms projection images by moving least squares, rigid variant in the plane (Schaefer et al. 2006): corrected(v) = recorded(f(v)).

   One work-item a pixel: ids are (u, v, view within the batch).
   recorded, corrected: (views, ROWS, COLUMNS) float32
   points: (views, COUNT, 4) float32: u and v of each control point at rest, then how far it moved along u and along v, pixels

   f(v) is written as a displacement, so that it is exactly nothing where nothing moved. Read by Keys' cubic convolution (a = -1/2),
   which gives a pixel itself at its center; outside, the border pixels go on. */

float keys_weight_inner(const float x) { return (1.5f * x - 2.5f) * x * x + 1.0f; }
float keys_weight_outer(const float x) { return ((-0.5f * x + 2.5f) * x - 4.0f) * x + 2.0f; }

float4 keys_weights(const float t)
{
    return (float4)(keys_weight_outer(1.0f + t), keys_weight_inner(t), keys_weight_inner(1.0f - t), keys_weight_outer(2.0f - t));
}

float read_row(__global const float *row, const int4 columns, const float4 weights)
{
    return dot((float4)(row[columns.x], row[columns.y], row[columns.z], row[columns.w]), weights);
}

float2 mls_shift(const float2 position, __global const float4 *points)
{
    float total = 0.0f;
    float2 arm = 0.0f, shift = 0.0f;
    for (int j = 0; j < COUNT; ++j) {
        const float2 offset = points[j].xy - position;
        const float weight = 1.0f / fmax(dot(offset, offset), 1e-12f);
        total += weight;
        arm += weight * offset;
        shift += weight * points[j].zw;
    }
    arm /= total; /* p* - v */
    shift /= total; /* q* - p* */
    float cosine = 0.0f, sine = 0.0f;
    for (int j = 0; j < COUNT; ++j) {
        const float2 offset = points[j].xy - position;
        const float weight = 1.0f / fmax(dot(offset, offset), 1e-12f);
        /* p x q and p . q, with the moved point as the resting one and what it moved more than the mean */
        const float2 p = offset - arm, extra = points[j].zw - shift;
        cosine += weight * (dot(p, p) + dot(p, extra));
        sine += weight * (p.x * extra.y - p.y * extra.x);
    }
    const float size = sqrt(cosine * cosine + sine * sine);
    if (size < 1e-20f)
        return shift;
    const float s = sine / size;
    /* 1 - cos without cancellation */
    const float versine = cosine > 0.0f ? s * s / (1.0f + cosine / size) : 1.0f - cosine / size;
    return shift - (float2)(-versine * arm.x - s * arm.y, s * arm.x - versine * arm.y);
}

__kernel void warp_mls(__global const float *recorded, __global const float4 *points, __global float *corrected)
{
    const int u = get_global_id(0), v = get_global_id(1), view = get_global_id(2);
    const float2 position = (float2)((float)u, (float)v);
    const float2 moved = position + mls_shift(position, points + (size_t)view * COUNT);
    const float2 inside = clamp(moved, (float2)(0.0f, 0.0f), (float2)(COLUMNS - 1, ROWS - 1));
    const int i = (int)inside.x, j = (int)inside.y;
    const float4 across = keys_weights(inside.x - i), up = keys_weights(inside.y - j);
    const int4 columns = clamp((int4)(i - 1, i, i + 1, i + 2), 0, COLUMNS - 1);
    const int4 rows = clamp((int4)(j - 1, j, j + 1, j + 2), 0, ROWS - 1);
    __global const float *image = recorded + (size_t)view * ROWS * COLUMNS;
    const float4 values = (float4)(read_row(image + rows.x * COLUMNS, columns, across), read_row(image + rows.y * COLUMNS, columns, across),
                                   read_row(image + rows.z * COLUMNS, columns, across), read_row(image + rows.w * COLUMNS, columns, across));
    corrected[((size_t)view * ROWS + v) * COLUMNS + u] = dot(values, up);
}
