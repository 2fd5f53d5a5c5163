/* Volumes read between their voxels by cubic B-splines, and compared by SSIM.

   Volumes are (z, y, x) float32, x fastest. One work-item a voxel: ids are (x, y, z). No sum crosses work-items: every digit is the same
   on any number of cores. */

/* ---- cubic B-splines: coefficients, axis by axis, then 4x4x4 of them a value ---- */

#define SPLINE_POLE -0.26794919243112270f
/* the filter's response falls by the pole a voxel: 3e-8 beyond 12 */
#define SPLINE_REACH 12

/* Index of the voxel that stands for index i of an axis of n voxels, mirrored about its first and last center. */
int mirrored(int i, const int n)
{
    if (n == 1) return 0;
    i = abs(i) % (2 * n - 2);
    return i < n ? i : 2 * n - 2 - i;
}

/* along: 0 for x, 1 for y, 2 for z */
__kernel void spline_coefficients(__global const float *values, const int along, __global float *coefficients)
{
    const int x = get_global_id(0), y = get_global_id(1), z = get_global_id(2);
    const int nx = get_global_size(0), ny = get_global_size(1), nz = get_global_size(2);
    const int place = along == 0 ? x : along == 1 ? y : z, count = along == 0 ? nx : along == 1 ? ny : nz;
    const long step = along == 0 ? 1 : along == 1 ? nx : (long)nx * ny, here = ((long)z * ny + y) * nx + x;
    __global const float *line = values + here - place * step;
    float sum = values[here], weight = SPLINE_POLE;
    if (place >= SPLINE_REACH && place < count - SPLINE_REACH)
        for (int k = 1; k <= SPLINE_REACH; ++k, weight *= SPLINE_POLE) sum += weight * (values[here - k * step] + values[here + k * step]);
    else
        for (int k = 1; k <= SPLINE_REACH; ++k, weight *= SPLINE_POLE)
            sum += weight * (line[mirrored(place - k, count) * step] + line[mirrored(place + k, count) * step]);
    coefficients[here] = 1.7320508075688772f * sum;
}

float4 spline_weights(const float t)
{
    const float s = 1.0f - t;
    return (float4)(s * s * s, 4.0f - 3.0f * t * t * (2.0f - t), 4.0f - 3.0f * s * s * (2.0f - s), t * t * t) * (1.0f / 6.0f);
}

/* resampled(x, y, z) = value at (x, y, z) + shift, in voxels; NaN more than half a voxel outside.

   coefficients: of the voxels from `source` on, `stored` of them, out of `whole` (x, y, z each). resampled: of the voxels from `target` on.
   a, b, c: rows x, y, z of the shift as a linear function of (x, y, z, 1): small numbers, so that no digit of the index is lost.
   A CPU takes the four coefficients of a row at once, which is four times as fast as gathering them for eight voxels. */
__attribute__((intel_vec_len_hint(1)))
__kernel void resample(__global const float *coefficients, const int4 source, const int4 stored, const int4 whole, const int4 target,
                       const float4 a, const float4 b, const float4 c, __global float *resampled)
{
    const int x = target.x + get_global_id(0), y = target.y + get_global_id(1), z = target.z + get_global_id(2);
    const long place = (get_global_id(2) * (long)get_global_size(1) + get_global_id(1)) * get_global_size(0) + get_global_id(0);
    const float4 at = (float4)(x, y, z, 1.0f);
    const float du = dot(a, at), dv = dot(b, at), dw = dot(c, at);
    const float fu = floor(du), fv = floor(dv), fw = floor(dw);
    const float u = x + du, v = y + dv, w = z + dw;
    if (!(u >= -0.5f && v >= -0.5f && w >= -0.5f && u < whole.x - 0.5f && v < whole.y - 0.5f && w < whole.z - 0.5f)) {
        resampled[place] = NAN;
        return;
    }
    const float4 wx = spline_weights(du - fu), wy = spline_weights(dv - fv), wz = spline_weights(dw - fw);
    const float ys[4] = {wy.x, wy.y, wy.z, wy.w}, zs[4] = {wz.x, wz.y, wz.z, wz.w};
    const int i = x + (int)fu - 1, j = y + (int)fv - 1, k = z + (int)fw - 1;
    const int4 low = (int4)(i, j, k, 0) - source;
    float4 sum = (float4)(0.0f);
    if (low.x >= 0 && low.y >= 0 && low.z >= 0 && low.x + 4 <= stored.x && low.y + 4 <= stored.y && low.z + 4 <= stored.z) {
        for (int n = 0; n < 4; ++n) {
            __global const float *row = coefficients + ((long)(low.z + n) * stored.y + low.y) * stored.x + low.x;
            float4 plane = (float4)(0.0f);
            for (int m = 0; m < 4; ++m) plane += ys[m] * vload4(0, row + m * stored.x);
            sum += zs[n] * plane;
        }
    } else {
        int columns[4];
        for (int n = 0; n < 4; ++n) columns[n] = mirrored(i + n, whole.x) - source.x;
        for (int n = 0; n < 4; ++n)
            for (int m = 0; m < 4; ++m) {
                const long slice = mirrored(k + n, whole.z) - source.z, line = mirrored(j + m, whole.y) - source.y;
                __global const float *row = coefficients + (slice * stored.y + line) * stored.x;
                sum += zs[n] * ys[m] * (float4)(row[columns[0]], row[columns[1]], row[columns[2]], row[columns[3]]);
            }
    }
    resampled[place] = dot(wx, sum);
}

/* ---- SSIM (Wang et al. 2004) in windows of 2 REACH + 1 voxels: means of x, y, xx, yy and xy axis by axis ---- */
#ifdef REACH
/* taken off before squaring: the middle of the values' range, so that single precision loses less */
#define MIDDLE 0.5f

/* moments: (5, z, y, x); columns nearer than REACH to the border are left alone: ids count from there */
__kernel void moments_along_x(__global const float *moving, __global const float *fixed, __constant float *weights, __global float *moments)
{
    const int y = get_global_id(1), z = get_global_id(2);
    const int nx = get_global_size(0) + 2 * REACH, ny = get_global_size(1);
    const long volume = (long)nx * ny * get_global_size(2), here = ((long)z * ny + y) * nx + get_global_id(0) + REACH;
    float p = 0.0f, q = 0.0f, pp = 0.0f, qq = 0.0f, pq = 0.0f;
    for (int k = -REACH; k <= REACH; ++k) {
        const float m = moving[here + k] - MIDDLE, f = fixed[here + k] - MIDDLE, weight = weights[k + REACH];
        p += weight * m, q += weight * f;
        pp += weight * m * m, qq += weight * f * f, pq += weight * m * f;
    }
    moments[here] = p, moments[here + volume] = q;
    moments[here + 2 * volume] = pp, moments[here + 3 * volume] = qq, moments[here + 4 * volume] = pq;
}

__kernel void moments_along_y(__global const float *along_x, const int nx, __constant float *weights, __global float *moments)
{
    const int ny = get_global_size(1) + 2 * REACH;
    const long volume = (long)nx * ny * get_global_size(2);
    const long here = ((long)get_global_id(2) * ny + get_global_id(1) + REACH) * nx + get_global_id(0) + REACH;
    for (int moment = 0; moment < 5; ++moment) {
        float sum = 0.0f;
        for (int k = -REACH; k <= REACH; ++k) sum += weights[k + REACH] * along_x[moment * volume + here + k * nx];
        moments[moment * volume + here] = sum;
    }
}

/* similarity: as many slices as there are ids; the moments have REACH more on either side.
   unbiased: n / (n - 1) of the window's voxels, or 1 */
__kernel void ssim(__global const float *along_y, const int nx, const int ny, __constant float *weights, const float unbiased, __global float *similarity)
{
    const long slice = (long)nx * ny, volume = slice * (get_global_size(2) + 2 * REACH);
    const long target = (get_global_id(2) * (long)ny + get_global_id(1) + REACH) * nx + get_global_id(0) + REACH;
    const long here = target + REACH * slice;
    float mean[5];
    for (int moment = 0; moment < 5; ++moment) {
        float sum = 0.0f;
        for (int k = -REACH; k <= REACH; ++k) sum += weights[k + REACH] * along_y[moment * volume + here + k * slice];
        mean[moment] = sum;
    }
    const float c1 = 1e-4f, c2 = 9e-4f; /* (0.01 range)^2 and (0.03 range)^2 */
    const float vp = unbiased * (mean[2] - mean[0] * mean[0]), vq = unbiased * (mean[3] - mean[1] * mean[1]);
    const float cross = unbiased * (mean[4] - mean[0] * mean[1]), p = mean[0] + MIDDLE, q = mean[1] + MIDDLE;
    similarity[target] = (2.0f * p * q + c1) * (2.0f * cross + c2) / ((p * p + q * q + c1) * (vp + vq + c2));
}
#endif
