/* Voxel-driven back-projection: volume += sum over views of image(u, v) / depth^2, the image taken between pixels linearly.

   A volume is a stack of columns, c fastest, then b, then a: c is the axis of the world that the detector's v axis follows. Where a voxel
   falls in a view depends on MOTION: 0 a 3x4 matrix, 1 moving least squares of three points (moving_least_squares.cl goes before this file), 2 a
   sampled field of displacements. Kernels:

   backproject_voxels   any placement, every voxel on its own: the reference, and what GPUs run. TEXTURES 1 reads images through texture units
                        (textures.cl goes before this file), 0 from a buffer; a work-item has EACH voxels, which share what they read of a view
   trace_nodes          homogeneous pixel of every eighth voxel, for the curves of backproject_columns
   backproject_columns  one voxel column at a time, for CPUs: CURVE 0 the column projects to a detector column, 1 to a straight line, 2 to
                        the curve through traced nodes. First the image is blended along that curve for every detector row, then
                        the voxels are interpolated along it; all loads are of neighboring floats, none is a gather.
   arrange_volume       from (a, b, c) to the order that the host wants

   first:    which of the images the first of the views is
   images:   (views, COLUMNS + 2 PAD, STRIDE) float32, detector rows fastest; row 0 at offset LEAD, column 0 at PAD; zero around it.
             With TEXTURES an array of images of that shape
   place:    MOTION 0: (views, 12) from voxel index (c, b, a, 1) of the slab to (u depth, v depth, depth), pixels and m.
             MOTION 1: (views, 24) as moving_least_squares.cl says, its map being the projection to (u depth, v depth, depth).
             MOTION 2: (views, 12) as MOTION 0, but from world positions relative to the anchor
   grid:     MOTION 1 and 2: (4, 3) m: steps along c, b, a, and voxel (0, 0, 0) relative to the anchor
   rest:     MOTION 1: as moving_least_squares.cl says. MOTION 2: index of the field's nodes from positions: 3 scales, 3 offsets, 3 counts (x, y, z)
   field:    MOTION 2: (views, z, y, x, 3) displacements in m */

#define SPACING 8 /* voxels between nodes, and voxels worked on at once */

#if MOTION == 0
typedef float3 point_t;

point_t point_at(const float c, const float b, const float a, __global const float *grid, __constant const float *rest)
{
    return (float3)(c, b, a);
}

float3 homogeneous_at(const point_t p, const int view, __global const float *place, __constant const float *rest,
                      __global const float *field)
{
    __global const float *m = place + 12 * view;
    return (float3)(m[0] * p.x + m[1] * p.y + m[2] * p.z + m[3], m[4] * p.x + m[5] * p.y + m[6] * p.z + m[7],
                    m[8] * p.x + m[9] * p.y + m[10] * p.z + m[11]);
}
#else

float3 position_of(const float c, const float b, const float a, __global const float *grid)
{
    return c * vload3(0, grid) + b * vload3(1, grid) + a * vload3(2, grid) + vload3(3, grid);
}
#endif

#if MOTION == 1
typedef mls_point point_t;

point_t point_at(const float c, const float b, const float a, __global const float *grid, __constant const float *rest)
{
    return mls_prepare(position_of(c, b, a, grid), rest);
}

float3 homogeneous_at(const point_t p, const int view, __constant const float *place, __constant const float *rest,
                      __global const float *field)
{
    return mls_moved(p, place + 24 * view);
}
#endif

#if MOTION == 2
typedef float3 point_t;

point_t point_at(const float c, const float b, const float a, __global const float *grid, __constant const float *rest)
{
    return position_of(c, b, a, grid);
}

float3 homogeneous_at(const point_t p, const int view, __global const float *place, __constant const float *rest,
                      __global const float *field)
{
    const float3 counts = vload3(2, rest), at = clamp(p * vload3(0, rest) + vload3(1, rest), 0.0f, counts - 1.0f);
    const float3 low = min(floor(at), max(counts - 2.0f, 0.0f)), f = at - low;
    const int nx = (int)counts.x, ny = (int)counts.y, nz = (int)counts.z;
    const int dx = nx > 1, dy = ny > 1 ? nx : 0;
    const size_t dz = nz > 1 ? (size_t)nx * ny : 0;
    const size_t node = (((size_t)view * nz + (int)low.z) * ny + (int)low.y) * nx + (int)low.x;
    const float3 near_low = mix(vload3(node, field), vload3(node + dx, field), f.x);
    const float3 near_high = mix(vload3(node + dy, field), vload3(node + dy + dx, field), f.x);
    const float3 far_low = mix(vload3(node + dz, field), vload3(node + dz + dx, field), f.x);
    const float3 far_high = mix(vload3(node + dz + dy, field), vload3(node + dz + dy + dx, field), f.x);
    const float3 q = p + mix(mix(near_low, near_high, f.y), mix(far_low, far_high, f.y), f.z);
    __global const float *m = place + 12 * view;
    return (float3)(m[0] * q.x + m[1] * q.y + m[2] * q.z + m[3], m[4] * q.x + m[5] * q.y + m[6] * q.z + m[7],
                    m[8] * q.x + m[9] * q.y + m[10] * q.z + m[11]);
}
#endif

#if MOTION == 1
#define PLACE __constant const float *place
#else
#define PLACE __global const float *place
#endif

#if TEXTURES
#define IMAGES __read_only image2d_array_t images

float image_at(IMAGES, const int view, const float u, const float v)
{
    return read_texture(images, v + LEAD, u + PAD, view);
}
#else
#define IMAGES __global const float *images

#ifdef FRACTIONS /* rounds places in a pixel as texture units do, to see what that costs */
#define ROUNDED(x) (rint((x) * FRACTIONS) / FRACTIONS)
#else
#define ROUNDED(x) (x)
#endif

float image_at(IMAGES, const int view, const float u, const float v)
{
    const float left = floor(u), low = floor(v), du = ROUNDED(u - left), dv = ROUNDED(v - low);
    __global const float *pixel = images + ((size_t)view * (COLUMNS + 2 * PAD) + (int)left + PAD) * STRIDE + LEAD + (int)low;
    const float here = pixel[0] + dv * (pixel[1] - pixel[0]);
    const float beside = pixel[STRIDE] + dv * (pixel[STRIDE + 1] - pixel[STRIDE]);
    return here + du * (beside - here);
}
#endif

/* ids: (c, b, a) of the first voxel of a work-item, whose others follow along c as many further as there are ids; ids may be rounded up
   beyond the slab; counts: voxels along c, b, a; volume: (a, b, stride) */
__kernel void backproject_voxels(IMAGES, PLACE, __global const float *grid, __constant const float *rest, __global const float *field,
                                 const int first, const int views, __global float *volume, const int4 counts, const int stride)
{
    const int c = get_global_id(0), b = get_global_id(1), a = get_global_id(2), step = get_global_size(0);
    if (c >= counts.x || b >= counts.y) return;
    point_t points[EACH];
    float sums[EACH];
    for (int i = 0; i < EACH; ++i) {
        points[i] = point_at(min(c + i * step, counts.x - 1), b, a, grid, rest);
        sums[i] = 0.0f;
    }
    for (int k = 0; k < views; ++k)
        for (int i = 0; i < EACH; ++i) {
            const float3 h = homogeneous_at(points[i], k, place, rest, field);
            const float inverse = h.z > 1e-6f ? 1.0f / h.z : 0.0f;
            const float u = clamp(h.x * inverse, -1.0f, (float)COLUMNS), v = clamp(h.y * inverse, -1.0f, (float)ROWS);
            sums[i] += image_at(images, first + k, u, v) * inverse * inverse;
        }
    __global float *line = volume + ((size_t)a * counts.y + b) * stride;
    for (int i = 0; i < EACH && c + i * step < counts.x; ++i) line[c + i * step] += sums[i];
}

/* ids: (c, b, a) of one node; nodes: (views, 3, a, b, c) of u depth, v depth and depth, which are linear in position where all moves
   alike, so that nothing is lost between nodes. They lie eight voxels apart, but none outside the slab, where a motion may not be known: the
   last ones along a and b are on its last voxels, and along c the last chord goes on straight; counts: voxels along c, b, a */
__kernel void trace_nodes(PLACE, __global const float *grid, __constant const float *rest, __global const float *field, const int views,
                          const int4 counts, __global float *nodes)
{
    const size_t c = get_global_id(0), b = get_global_id(1), a = get_global_id(2);
    const size_t line = get_global_size(0), plane = line * get_global_size(1), all = plane * get_global_size(2);
    const float fb = min(SPACING * (int)b, counts.y - 1), fa = min(SPACING * (int)a, counts.z - 1);
    const int at = SPACING * (int)c, last = counts.x - 1, before = max(last - 1, 0) / SPACING * SPACING;
    const float further = at > last && last > 0 ? (float)(at - last) / (float)(last - before) : 0.0f;
    const point_t point = point_at((float)(last > 0 ? min(at, last) : at), fb, fa, grid, rest);
    const point_t previous = point_at((float)before, fb, fa, grid, rest);
    __global float *out = nodes + a * plane + b * line + c;
    for (int k = 0; k < views; ++k) {
        float3 h = homogeneous_at(point, k, place, rest, field);
        if (further > 0.0f) h += further * (h - homogeneous_at(previous, k, place, rest, field));
        out[0] = h.x;
        out[all] = h.y;
        out[2 * all] = h.z;
        out += 3 * all;
    }
}

#define LANES ((float8)(0, 1, 2, 3, 4, 5, 6, 7))
#define QUADS ((float8)(0, 1, 2, 3, 0, 1, 2, 3))
#define SCRATCH (STRIDE + TRAIL)

#if CURVE == 2
#define INSIDE(row, steps) clamp(row, 0, SCRATCH - 5 - (steps)) /* a motion may be wilder than its samples promised */
#else
#define INSIDE(row, steps) (row)
#endif

/* Eight voxels at places v of a blended column, whose distances are such that within each half of the vector the lanes' rows lie from
   back less to steps - back more than their number beyond the first. Each half loads whole runs of rows, shifted by 0 … steps + 1, and
   adds up the slopes between them as far as each lane has come: linear interpolation without a gather. */
inline float8 sample(const float *column, const float8 v, const int back, const int steps)
{
    const float8 base = floor(v).s00004444, t = v - base - (QUADS - (float)back);
    const float *low = column + INSIDE((int)base.s0 - back, steps), *high = column + INSIDE((int)base.s4 - back, steps);
    float8 last = (float8)(vload4(0, low), vload4(0, high)), sum = last;
    for (int s = 0; s <= steps; ++s) {
        const float8 next = (float8)(vload4(0, low + s + 1), vload4(0, high + s + 1));
        sum += clamp(t - (float)s, 0.0f, 1.0f) * (next - last);
        last = next;
    }
    return sum;
}

/* The same for the two usual spacings, up to 4/3 and up to 5/3 rows a voxel. */
inline float8 sample_1(const float *column, const float8 v)
{
    const float8 base = floor(v).s00004444, t = v - base - QUADS, near = min(t, 1.0f);
    const float *low = column + INSIDE((int)base.s0, 1), *high = column + INSIDE((int)base.s4, 1);
    const float8 a = (float8)(vload4(0, low), vload4(0, high)), b = (float8)(vload4(0, low + 1), vload4(0, high + 1));
    const float8 c = (float8)(vload4(0, low + 2), vload4(0, high + 2));
    return a + near * (b - a) + (t - near) * (c - b);
}

inline float8 sample_2(const float *column, const float8 v)
{
    const float8 base = floor(v).s00004444, t = v - base - QUADS, near = min(t, 1.0f), far = max(t, 2.0f) - 2.0f;
    const float *low = column + INSIDE((int)base.s0, 2), *high = column + INSIDE((int)base.s4, 2);
    const float8 a = (float8)(vload4(0, low), vload4(0, high)), b = (float8)(vload4(0, low + 1), vload4(0, high + 1));
    const float8 c = (float8)(vload4(0, low + 2), vload4(0, high + 2)), d = (float8)(vload4(0, low + 3), vload4(0, high + 3));
    return a + near * (b - a) + (t - near - far) * (c - b) + far * (d - c);
}

/* out[c] += weight(c) sample(place(c)) for c from begin to end in eights, whatever expressions of c the last two are */
#define ADD_EIGHTS(expression)                                                                                                             \
    for (int c = begin; c < end; c += SPACING) vstore8(vload8(0, out + c) + (expression), 0, out + c)

/* Eight rows of an image, taken at columns u, which increase or decrease by at most steps over the eight rows. */
inline float8 blend(__global const float *rows, const float8 u, const int steps)
{
    const int left = clamp((int)(min(u.s0, u.s7) + PAD), 0, COLUMNS + 2 * PAD - 2 - steps);
    const float8 t = u - (float)(left - PAD);
    __global const float *column = rows + left * STRIDE;
    float8 last = vload8(0, column), sum = last;
    for (int s = 0; s <= steps; ++s) {
        const float8 next = vload8(0, column + (s + 1) * STRIDE);
        sum += clamp(t - (float)s, 0.0f, 1.0f) * (next - last);
        last = next;
    }
    return sum;
}

/* The same where the columns change by less than one: u is low + tilt lane. */
inline float8 blend_1(__global const float *rows, const float low, const float tilt)
{
    const int left = clamp((int)(low + min(7.0f * tilt, 0.0f) + PAD), 0, COLUMNS + 2 * PAD - 3);
    const float8 t = (low - (float)(left - PAD)) + tilt * LANES, near = min(t, 1.0f);
    __global const float *column = rows + left * STRIDE;
    const float8 a = vload8(0, column), b = vload8(0, column + STRIDE), c = vload8(0, column + 2 * STRIDE);
    return a + near * (b - a) + (t - near) * (c - b);
}

/* Blends rows r, in eights, up to where end is reached, along the line offset + tilt row; returns the next r. */
inline int blend_rows(__global const float *image, float *column, int r, const float end, const float offset, const float tilt,
                      const int sideways)
{
    for (; (float)r < end; r += 8) {
        const float low = offset + tilt * (float)r;
        vstore8(sideways == 1 ? blend_1(image + r, low, tilt) : blend(image + r, low + tilt * LANES, sideways), 0, column + r);
    }
    return r;
}

/* ids: (b, a) of one voxel column; volume: (a, b, stride), stride a multiple of eight; nodes: as of trace_nodes, NODES along c */
__attribute__((intel_vec_len_hint(1)))
__kernel void backproject_columns(__global const float *images, PLACE, __global const float *nodes, const int first, const int views,
                                  __global float *volume, const int count, const int stride)
{
    const int b = get_global_id(0), a = get_global_id(1);
    const float fb = b, fa = a;
    __global float *out = volume + ((size_t)a * get_global_size(0) + b) * stride;
    float column[SCRATCH];
    for (int i = 0; i < SCRATCH; i += 8) vstore8((float8)0.0f, 0, column + i);
#if CURVE == 2
    const size_t line = NODES, plane = line * ((get_global_size(0) - 1) / SPACING + 2), all = plane * ((get_global_size(1) - 1) / SPACING + 2);
    const float wb = (float)(b % SPACING) / clamp((int)get_global_size(0) - 1 - b / SPACING * SPACING, 1, SPACING);
    const float wa = (float)(a % SPACING) / clamp((int)get_global_size(1) - 1 - a / SPACING * SPACING, 1, SPACING);
    const float w00 = (1.0f - wa) * (1.0f - wb), w01 = (1.0f - wa) * wb, w10 = wa * (1.0f - wb), w11 = wa * wb;
#endif
    for (int k = 0; k < views; ++k) {
        __global const float *image = images + (size_t)(first + k) * (COLUMNS + 2 * PAD) * STRIDE;
#if CURVE < 2
        __global const float *m = place + 12 * k;
        const float u0 = m[1] * fb + m[2] * fa + m[3], v0 = m[5] * fb + m[6] * fa + m[7], depth0 = m[9] * fb + m[10] * fa + m[11];
#endif
#if CURVE == 0
        const float inverse = 1.0f / depth0, u = u0 * inverse;
        if (!(u > -1.0f && u < (float)COLUMNS)) continue;
        const float start = v0 * inverse + LEAD, dv = m[4] * inverse;
        const int begin = clamp((int)floor((LEAD - 1.0f - start) / dv), 0, count) & ~(SPACING - 1);
        const int end = clamp((int)ceil((LEAD + (float)ROWS - start) / dv), 0, count);
        if (begin >= end) continue;
        const float left = floor(u), weight = inverse * inverse, right = (u - left) * weight, rest = weight - right;
        __global const float *source = image + ((int)left + PAD) * STRIDE;
        const int last_row = min(STRIDE, (int)(start + dv * ((end + 7) & ~7)) + 2);
        for (int r = clamp((int)floor(start + dv * begin), 0, STRIDE) & ~7; r < last_row; r += 8)
            vstore8(rest * vload8(0, source + r) + right * vload8(0, source + STRIDE + r), 0, column + r);
        const int back = max((int)ceil(3.0f * (1.0f - dv)), 0), steps = back + max((int)ceil(3.0f * (dv - 1.0f)), 0);
        const float8 ramp = start + dv * LANES;
        if (steps == 1 && back == 0) ADD_EIGHTS(sample_1(column, ramp + dv * c));
        else if (steps == 2 && back == 0) ADD_EIGHTS(sample_2(column, ramp + dv * c));
        else ADD_EIGHTS(sample(column, ramp + dv * c, back, steps));
#else
        /* rows and squared inverse depths at the nodes, and for CURVE 2 the line (offset + slope row) of columns after each */
        float rows[NODES + 8], weights[NODES + 8];
#if CURVE == 1
        for (int n = 0; n < NODES; n += 8) {
            const float8 c = (float)(SPACING * n) + (float)SPACING * LANES, inverse = 1.0f / (depth0 + m[8] * c);
            vstore8((v0 + m[4] * c) * inverse + LEAD, 0, rows + n);
            vstore8(inverse * inverse, 0, weights + n);
        }
        const float u_first = u0 / depth0, u_last = (u0 + m[0] * (float)(SPACING * (NODES - 1))) / (depth0 + m[8] * (float)(SPACING * (NODES - 1)));
        const float slope = (u_last - u_first) / (rows[NODES - 1] - rows[0]), offset = u_first - slope * rows[0];
        const float near_u = min(u_first, u_last), far_u = max(u_first, u_last), steepest = fabs(slope);
        const float least = min(rows[1] - rows[0], rows[NODES - 1] - rows[NODES - 2]) / SPACING;
        const float most = max(rows[1] - rows[0], rows[NODES - 1] - rows[NODES - 2]) / SPACING;
#else
        float us[NODES + 8], slopes[NODES + 8], offsets[NODES + 8];
        __global const float *corner = nodes + 3 * all * k + (a / SPACING) * plane + (b / SPACING) * line;
        for (int n = 0; n < NODES; n += 8) {
#define BETWEEN(p) (w00 * vload8(0, p) + w01 * vload8(0, p + line) + w10 * vload8(0, p + plane) + w11 * vload8(0, p + plane + line))
            const float8 inverse = 1.0f / BETWEEN(corner + 2 * all + n);
            vstore8(BETWEEN(corner + n) * inverse, 0, us + n);
            vstore8(BETWEEN(corner + all + n) * inverse + LEAD, 0, rows + n);
            vstore8(inverse * inverse, 0, weights + n);
        }
        float8 least_8 = 1e9f, most_8 = -1e9f, near_8 = 1e9f, far_8 = -1e9f, steepest_8 = 0.0f;
        for (int n = 0; n < NODES - 1; n += 8) {
            const float8 u = vload8(0, us + n), row = vload8(0, rows + n);
            const int8 real = (float)n + LANES < (float)(NODES - 1);
            const float8 rise = real ? vload8(0, rows + n + 1) - row : least_8, slope = real ? (vload8(0, us + n + 1) - u) / rise : 0.0f;
            vstore8(slope, 0, slopes + n);
            vstore8(u - slope * row, 0, offsets + n);
            least_8 = min(least_8, rise), most_8 = real ? max(most_8, rise) : most_8, steepest_8 = max(steepest_8, fabs(slope));
            near_8 = real ? min(near_8, u) : near_8, far_8 = real ? max(far_8, u) : far_8;
        }
#define FOLDED(fold, x) fold(fold(fold(x.s0, x.s1), fold(x.s2, x.s3)), fold(fold(x.s4, x.s5), fold(x.s6, x.s7)))
        const float near_u = min(FOLDED(min, near_8), us[NODES - 1]), far_u = max(FOLDED(max, far_8), us[NODES - 1]);
        const float least = FOLDED(min, least_8) / SPACING, most = FOLDED(max, most_8) / SPACING, steepest = FOLDED(max, steepest_8);
#endif
        if (!(far_u > -1.0f && near_u < (float)COLUMNS)) continue;
        const float from = max(rows[0], LEAD - 1.0f), to = min(rows[NODES - 1], LEAD + (float)ROWS);
        const int first_row = clamp((int)from, 0, STRIDE) & ~7, last_row = clamp((int)to + 2, 0, STRIDE);
        const int sideways = clamp((int)ceil(7.0f * steepest), 1, PAD - 3);
#if CURVE == 1
        blend_rows(image, column, first_row, (float)last_row, offset, slope, sideways);
#else
        /* every block of rows takes the line of the two nodes that its middle lies between */
        int r = first_row;
        for (int n = 0; n < NODES - 2; ++n)
            r = blend_rows(image, column, r, min(rows[n + 1] - 3.5f, (float)last_row), offsets[n], slopes[n], sideways);
        blend_rows(image, column, r, (float)last_row, offsets[NODES - 2], slopes[NODES - 2], sideways);
#endif
        int begin = 0, end = count;
        while (begin < end && rows[begin / SPACING + 1] <= LEAD - 1.0f) begin += SPACING;
        while (end > begin && rows[(end - 1) / SPACING] >= LEAD + (float)ROWS) end -= SPACING;
        const int back = clamp((int)ceil(3.0f * (1.0f - least)), 0, 6), steps = back + clamp((int)ceil(3.0f * (most - 1.0f)), 0, 6);
#define BETWEEN_NODES(values) (values[c / SPACING] + (values[c / SPACING + 1] - values[c / SPACING]) * (LANES / SPACING))
        if (steps == 1 && back == 0) ADD_EIGHTS(BETWEEN_NODES(weights) * sample_1(column, BETWEEN_NODES(rows)));
        else if (steps == 2 && back == 0) ADD_EIGHTS(BETWEEN_NODES(weights) * sample_2(column, BETWEEN_NODES(rows)));
        else ADD_EIGHTS(BETWEEN_NODES(weights) * sample(column, BETWEEN_NODES(rows), back, steps));
#endif
    }
}

/* ids: any two of the slab's axes first, contiguous in the target first; steps: elements of the target between voxels along c, b, a */
__kernel void arrange_volume(__global const float *volume, __global float *target, const int stride, const int nb, const int along_c,
                             const int step_c, const int step_b, const long step_a)
{
    const int first = get_global_id(0), second = get_global_id(1), a = get_global_id(2);
    const int c = along_c ? first : second, b = along_c ? second : first;
    target[a * step_a + (long)b * step_b + (long)c * step_c] = volume[((size_t)a * nb + b) * stride + c];
}
