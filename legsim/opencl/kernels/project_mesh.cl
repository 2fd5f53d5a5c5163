/* Line integrals along the rays of one view, one work-group a tile, one work-item a pixel. After mesh_crossings.cl; built with CHANNELS, how
 * many integrals of each ray are wanted: one of attenuation, or one of every material's presence.
 *
 * values: (parts + 1, CHANNELS), such as attenuations in 1/m, row 0 for the outside. directions: 3 columns of 3: the ray of pixel (u, v), of unit depth, is
 * directions @ (u, v, 1). listed: the tiles to do, (launched,). needed: crossings of the fullest pixel of each tile. image:
 * (CHANNELS, rows, columns).
 */
void add_stretch(float *sums, __global const float *values, const int last, const float length)
{
    for (int c = 0; c < CHANNELS; ++c)
        sums[c] += values[CHANNELS * last + c] * length;
}

void integrals(const LIST float *depths, const LIST int *tags, const int count, __global const float *values, float *sums)
{
    Place place;
    start_outside(&place);
    for (int c = 0; c < CHANNELS; ++c)
        sums[c] = 0.0f;
    float from = 0.0f;
    for (int k = 0; k < count; ++k) {
        const float to = depths[(size_t)k * PIXELS];
        add_stretch(sums, values, last_inside(&place), to - from);
        from = to;
        pass(&place, tags[(size_t)k * PIXELS]);
    }
    if (!place.twice)
        return;
    start_outside(&place);
    for (int c = 0; c < CHANNELS; ++c)
        sums[c] = 0.0f;
    for (int k = 0; k < count; ++k) {
        const float to = depths[(size_t)k * PIXELS];
        add_stretch(sums, values, last_inside(&place), to - from);
        from = to;
        pass_counting(&place, tags, k);
    }
}

__kernel __attribute__((reqd_work_group_size(BAND, GROUP_BANDS, 1)))
void integrate(__global const int *triangles, __global const int *parts, __global const int2 *whole, __global const float4 *rest,
               __global const uint *entries, __global const ulong *starts, __global const uint *listed, const int2 pixels, const int2 tiles,
               __global const float *values, __global const float *directions, __global int *needed, __global float *image,
               const int capacity, __global float *spare_depths, __global int *spare_tags)
{
    const size_t tile = listed[get_group_id(0)];
    const int2 corner = TILE * (int2)((int)(tile % tiles.x), (int)(tile / tiles.x));
    DECLARE_LISTS(depths, tags);
    int found[OWN_BANDS];
    collect(triangles, parts, whole, rest, entries, starts[tile], starts[tile + 1], corner, depths, tags, capacity, found);
    for (int own = 0; own < OWN_BANDS; ++own) {
        const int2 pixel = pixel_of(corner, own);
        const size_t first = slot_of(own);
        const int count = ordered(depths + first, tags + first, found[own], capacity, &needed[tile]);
        float sums[CHANNELS];
        integrals(depths + first, tags + first, count, values, sums);
        const float3 ray = vload3(0, directions) * (float)pixel.x + vload3(1, directions) * (float)pixel.y + vload3(2, directions);
        if (pixel.x < pixels.x && pixel.y < pixels.y)
            for (int c = 0; c < CHANNELS; ++c)
                image[((size_t)c * pixels.y + pixel.y) * pixels.x + pixel.x] = sums[c] * length(ray);
    }
}
