/* Which triangles does each ray of a grid cross, and where: what projector and voxelizer share. Prepended to their kernels.
 *
 * Rays pass through the integer points (u, v) of an image. A vertex is (U, V, D, W) = rows @ (x, y, z, 1) with u = U/W, v = V/W and
 * depth D; W = D + constant for a cone of rays, W = 1 for parallel ones. D is linear along a ray.
 *
 * Watertight by construction. Every vertex is rounded once a pixel (its coordinates relative to the pixel), the same for all
 * triangles that share it; signs of the edge functions of the rounded coordinates are exact (the difference of two products with
 * one fma each is off by less than 2 ulp, Jeannerod, Louvet and Muller 2013, and exact where it is zero); zeros are decided as if the
 * pixel stood at (u + e, v + e^2) for a vanishing e > 0. What a ray meets is therefore exactly what it meets in some closed
 * surface: the signs of its crossings cancel for each closed part, whatever the rounding. Contraction would break this.
 *
 * A tile of TILE x TILE pixels is done by a work-group of (2 TILE, GROUP_BANDS): a row of work-items covers a band of two rows of
 * pixels, so that what it skips is skipped by all of a CPU's vector, and each takes OWN_BANDS bands, one after the other.
 *
 * Integers given at build time: TILE (8), GROUP_BANDS (1 to TILE / 2), WORDS (32-bit words that hold one bit a part), and CAPACITY (crossings
 * kept a pixel) or LISTS_IN_GLOBAL_MEMORY (then `capacity` is an argument).
 */
#pragma OPENCL FP_CONTRACT OFF

#define PIXELS (TILE * TILE)
#define BAND (2 * TILE)
#define OWN_BANDS (TILE / 2 / GROUP_BANDS)
#ifdef LISTS_IN_GLOBAL_MEMORY
#define LIST __global
#else
#define LIST __local
#endif

/* Sum of four products of pairs (hi + lo), as a pair: compensated dot product of Ogita, Rump and Oishi 2005. */
float2 row_times_point(__global const float *row, const float *high, const float *low)
{
    float sum = row[3], rest = row[7];
    for (int k = 0; k < 3; ++k) {
        const float product = row[k] * high[k];
        const float product_rest = fma(row[k], high[k], -product);
        const float total = sum + product;
        const float back = total - sum;
        const float total_rest = (sum - (total - back)) + (product - back);
        sum = total;
        rest += total_rest + product_rest + (row[k] * low[k] + row[4 + k] * high[k]);
    }
    const float total = sum + rest;
    return (float2)(total, rest - (total - sum));
}

/* Quotient of two pairs as a whole number and a fraction in [0, 1], a multiple of 2^-30 so that products never underflow. */
void split_quotient(const float2 a, const float2 b, int *whole, float *fraction)
{
    const float q = a.x / b.x;
    const float rest = (fma(-q, b.x, a.x) + (a.y - q * b.y)) / b.x;
    const float down = floor(q);
    float part = (q - down) + rest;
    const float carry = floor(part);
    part -= carry;
    *whole = convert_int_sat(down) + convert_int_sat(carry);
    *fraction = rint(part * 0x1p30f) * 0x1p-30f;
}

/* One work-item a vertex of one part. points: (count, 6) coordinates as high x, y, z, low x, y, z. rows: (4, 8), each row of four as
 * high then low. whole, rest: (u, v) whole parts; (u, v) fractions, depth, 1 / W; written from `first` on. */
__kernel void place_vertices(__global const float *points, const uint count, __global const float *rows, const ulong first,
                             __global int2 *whole, __global float4 *rest)
{
    const size_t i = get_global_id(0);
    if (i >= count)
        return;
    float high[3], low[3];
    for (int k = 0; k < 3; ++k) {
        high[k] = points[6 * i + k];
        low[k] = points[6 * i + 3 + k];
    }
    const float2 w = row_times_point(rows + 24, high, low);
    const float2 d = row_times_point(rows + 16, high, low);
    int column, row;
    float column_fraction, row_fraction;
    split_quotient(row_times_point(rows, high, low), w, &column, &column_fraction);
    split_quotient(row_times_point(rows + 8, high, low), w, &row, &row_fraction);
    whole[first + i] = (int2)(column, row);
    rest[first + i] = (float4)(column_fraction, row_fraction, d.x, 1.0f / w.x);
}

float difference_of_products(const float a, const float b, const float c, const float d)
{
    const float cd = c * d;
    return fma(a, b, -cd) + fma(-c, d, cd);
}

/* Range of pixels [low, high] whose centers three coordinates (whole + fraction) may enclose, opened by what rounding may move a vertex. */
int2 pixel_range(const int a, const int b, const int c, const float fa, const float fb, const float fc)
{
    const int base = min(a, min(b, c));
    const float ra = (float)(a - base) + fa, rb = (float)(b - base) + fb, rc = (float)(c - base) + fc;
    const float least = min(ra, min(rb, rc)), most = max(ra, max(rb, rc));
    const float margin = 0x1p-12f + 0x1p-21f * most;
    return (int2)(base + convert_int_sat(ceil(least - margin)), base + convert_int_sat(floor(most + margin)));
}

/* Can the triangle, in coordinates relative to the tile's middle, hold a pixel of the tile? Errs on the side of yes. */
int meets_tile(const float2 a, const float2 b, const float2 c)
{
    const float2 corner[3] = {a, b, c};
    int left = 1, right = 1;
    for (int k = 0; k < 3; ++k) {
        const float2 p = corner[k], q = corner[(k + 1) % 3];
        const float products = fabs(p.x * q.y) + fabs(p.y * q.x);
        const float reach = 0.5f * TILE * (fabs(p.x - q.x) + fabs(p.y - q.y)) + 0x1p-18f * products;
        const float edge = p.x * q.y - p.y * q.x;
        left &= edge >= -reach;
        right &= edge <= reach;
    }
    return left | right;
}

/* Sorts triangles into tiles, one work-item a triangle, in two runs: counting (entries null) and filling. tiles: (rows, columns) of
 * tiles. slots: how many triangles each tile has so far, counted from `starts` when filling. */
__kernel void sort_into_tiles(__global const int *triangles, const uint count, __global const int2 *whole, __global const float4 *rest,
                              const int2 pixels, const int2 tiles, __global int *slots, __global const ulong *starts,
                              const int filling, __global uint *entries)
{
    const size_t i = get_global_id(0);
    if (i >= count)
        return;
    const size_t a = triangles[3 * i], b = triangles[3 * i + 1], c = triangles[3 * i + 2];
    const int2 wa = whole[a], wb = whole[b], wc = whole[c];
    const float4 ra = rest[a], rb = rest[b], rc = rest[c];
    int2 columns = pixel_range(wa.x, wb.x, wc.x, ra.x, rb.x, rc.x);
    int2 rows = pixel_range(wa.y, wb.y, wc.y, ra.y, rb.y, rc.y);
    columns = (int2)(max(columns.x, 0), min(columns.y, pixels.x - 1));
    rows = (int2)(max(rows.x, 0), min(rows.y, pixels.y - 1));
    if (columns.x > columns.y || rows.x > rows.y)
        return;
    columns /= TILE;
    rows /= TILE;
    const int large = (columns.y - columns.x + 1) * (rows.y - rows.x + 1) > 4;
    for (int y = rows.x; y <= rows.y; ++y)
        for (int x = columns.x; x <= columns.y; ++x) {
            const int2 corner = (int2)(x * TILE, y * TILE);
            const float2 middle = 0.5f * TILE - 0.5f;
            if (large && !meets_tile(convert_float2(wa - corner) + ra.xy - middle, convert_float2(wb - corner) + rb.xy - middle,
                                     convert_float2(wc - corner) + rc.xy - middle))
                continue;
            const size_t tile = (size_t)y * tiles.x + x;
            const int slot = atomic_inc(&slots[tile]);
            if (filling)
                entries[starts[tile] + slot] = (uint)i;
        }
}

/* Sign of the edge from p to q seen from the pixel at the origin; a zero is decided as if the pixel stood at (e, e^2). */
float edge_side(const float edge, const float px, const float py, const float qx, const float qy)
{
    return edge != 0.0f ? edge : (py != qy ? py - qy : qx - px);
}

/* Crossings of the rays of a work-item's pixels, one in each of its bands, with the tile's triangles [start, stop): depth and tag
 * (2 part + (sign > 0)) go to lists of stride PIXELS. found: (OWN_BANDS) how many there are, of which only the first `capacity` are kept. */
void collect(__global const int *triangles, __global const int *parts, __global const int2 *whole, __global const float4 *rest,
             __global const uint *entries, const ulong start, const ulong stop, const int2 corner,
             LIST float *depths, LIST int *tags, const int capacity, int *found)
{
    const float x = (float)(get_local_id(0) % TILE), odd = (float)(get_local_id(0) / TILE);
    for (int own = 0; own < OWN_BANDS; ++own)
        found[own] = 0;
    for (ulong e = start; e < stop; ++e) {
        const size_t i = entries[e];
        const size_t a = triangles[3 * i], b = triangles[3 * i + 1], c = triangles[3 * i + 2];
        const float4 ra = rest[a], rb = rest[b], rc = rest[c];
        const float2 ta = convert_float2(whole[a] - corner) + ra.xy;
        const float2 tb = convert_float2(whole[b] - corner) + rb.xy;
        const float2 tc = convert_float2(whole[c] - corner) + rc.xy;
        const float lowest = min(ta.y, min(tb.y, tc.y)), highest = max(ta.y, max(tb.y, tc.y));
        const float ax = ta.x - x, bx = tb.x - x, cx = tc.x - x;
        const int tag = 2 * parts[i];
        #pragma unroll
        for (int own = 0; own < OWN_BANDS; ++own) {
            const int band = own * GROUP_BANDS + (int)get_local_id(1);
            const float first_row = 2.0f * (float)band;
            if (highest >= first_row && lowest <= first_row + 1.0f) {
                const float y = first_row + odd;
                const float ay = ta.y - y, by = tb.y - y, cy = tc.y - y;
                const float ea = difference_of_products(bx, cy, by, cx);
                const float eb = difference_of_products(cx, ay, cy, ax);
                const float ec = difference_of_products(ax, by, ay, bx);
                const float sa = edge_side(ea, bx, by, cx, cy), sb = edge_side(eb, cx, cy, ax, ay), sc = edge_side(ec, ax, ay, bx, by);
                const int positive = (sa > 0.0f) & (sb > 0.0f) & (sc > 0.0f), negative = (sa < 0.0f) & (sb < 0.0f) & (sc < 0.0f);
                if (positive | negative) {
                    /* barycentric weights in space, not in the image: no differences of like numbers, since all have one sign */
                    const float na = ea * ra.w, nb = eb * rb.w, nc = ec * rc.w;
                    const float sum = na + nb + nc;
                    const float shift = (nb * (rb.z - ra.z) + nc * (rc.z - ra.z)) / sum;
                    if (found[own] < capacity) {
                        const size_t slot = (size_t)found[own] * PIXELS + band * BAND + get_local_id(0);
                        depths[slot] = ra.z + (sum != 0.0f ? shift : 0.0f);
                        tags[slot] = tag + positive;
                    }
                    ++found[own];
                }
            }
        }
    }
}

/* Orders a pixel's crossings by depth. Neighbors swap, so that all pixels of a vector touch the same slots; lists are short. */
void sort_by_depth(LIST float *depths, LIST int *tags, const int count)
{
    for (int last = count - 1; last > 0; --last)
        for (int j = 0; j < last; ++j) {
            const size_t here = (size_t)j * PIXELS, next = here + PIXELS;
            const float d = depths[here], nd = depths[next];
            const int t = tags[here], nt = tags[next];
            const int swap = d > nd || (d == nd && t > nt);
            depths[here] = swap ? nd : d;
            depths[next] = swap ? d : nd;
            tags[here] = swap ? nt : t;
            tags[next] = swap ? t : nt;
        }
}

/* Declares the lists `depths` and `tags` of a work-group inside a kernel whose last arguments are capacity, spare_depths and spare_tags. */
#ifdef LISTS_IN_GLOBAL_MEMORY
#define DECLARE_LISTS(depths, tags)                                                                   \
    __global float *depths = spare_depths + get_group_id(0) * (size_t)capacity * PIXELS;              \
    __global int *tags = spare_tags + get_group_id(0) * (size_t)capacity * PIXELS
#else
#define DECLARE_LISTS(depths, tags)                                                                   \
    __local float depths[CAPACITY * PIXELS];                                                          \
    __local int tags[CAPACITY * PIXELS]
#endif

/* Pixel (column, row) of a work-item in its band `own`, and where its lists begin. */
int2 pixel_of(const int2 corner, const int own)
{
    const int band = own * GROUP_BANDS + (int)get_local_id(1);
    return corner + (int2)((int)(get_local_id(0) % TILE), 2 * band + (int)(get_local_id(0) / TILE));
}

size_t slot_of(const int own)
{
    return (own * GROUP_BANDS + get_local_id(1)) * BAND + get_local_id(0);
}

/* Orders the crossings that a pixel's lists hold and returns how many; those that did not fit raise `needed`, and the tile is done again. */
int ordered(LIST float *depths, LIST int *tags, const int found, const int capacity, __global int *needed)
{
    if (found > capacity)
        atomic_max(needed, found);
    const int count = min(found, capacity);
    sort_by_depth(depths, tags, count);
    return count;
}

/* Where a ray is: one bit a part. */
typedef struct {
    uint inside[WORDS];
    /* sign of the crossing that led inside */
    uint positive[WORDS];
    /* a part wound around the ray twice, which its bit cannot hold: sum the signs instead */
    uint twice;
} Place;

void start_outside(Place *place)
{
    for (int word = 0; word < WORDS; ++word)
        place->inside[word] = place->positive[word] = 0u;
    place->twice = 0u;
}

/* Passes a crossing, as long as windings are -1, 0 or 1. */
void pass(Place *place, const int tag)
{
    const uint bit = 1u << ((tag >> 1) & 31);
    for (int word = 0; word < WORDS; ++word) {
        const uint chosen = word == (tag >> 6) ? bit : 0u;
        const uint was_inside = place->inside[word] & chosen;
        const uint sign = (tag & 1) ? chosen : 0u;
        place->twice |= was_inside & ~(place->positive[word] ^ sign);
        place->inside[word] ^= chosen;
        place->positive[word] = (place->positive[word] & ~chosen) | sign;
    }
}

/* Passes crossing k whatever the windings: the part's is the sum of its signs up to k. */
void pass_counting(Place *place, const LIST int *tags, const int k)
{
    const int tag = tags[(size_t)k * PIXELS];
    int winding = 0;
    for (int j = 0; j <= k; ++j) {
        const int other = tags[(size_t)j * PIXELS];
        winding += (other >> 1) == (tag >> 1) ? 2 * (other & 1) - 1 : 0;
    }
    const uint bit = 1u << ((tag >> 1) & 31);
    for (int word = 0; word < WORDS; ++word) {
        const uint chosen = word == (tag >> 6) ? bit : 0u;
        place->inside[word] = (place->inside[word] & ~chosen) | (winding != 0 ? chosen : 0u);
    }
}

/* 1 + the last part that contains the place, 0 for none. */
int last_inside(const Place *place)
{
    int last = 0;
    for (int word = 0; word < WORDS; ++word)
        last = place->inside[word] != 0u ? 32 * word + 32 - (int)clz(place->inside[word]) : last;
    return last;
}
