/* Line integrals of attenuation along the rays of one view, one work-group a tile, one work-item a pixel. After mesh_hits.cl.
 *
 * attenuations: (parts + 1) 1/m, entry 0 for the outside. directions: 3 columns of 3: the ray of pixel (u, v), of unit depth, is
 * directions @ (u, v, 1). listed: the tiles to do, (launched,). needed: crossings of the fullest pixel of each tile. image: (rows, columns).
 */
__kernel __attribute__((reqd_work_group_size(2 * TILE, TILE / 2, 1)))
void integrate(__global const int *triangles, __global const int *parts, __global const int2 *whole, __global const float4 *rest,
               __global const uint *entries, __global const ulong *starts, __global const uint *listed, const int2 pixels, const int2 tiles,
               __global const float *attenuations, __global const float *directions, __global int *needed, __global float *image,
               const int capacity, __global float *spare_depths, __global int *spare_tags)
{
    const size_t tile = listed[get_group_id(0)];
    const int2 corner = TILE * (int2)((int)(tile % tiles.x), (int)(tile / tiles.x));
    const int column = corner.x + (int)(get_local_id(0) % TILE);
    const int row = corner.y + 2 * (int)get_local_id(1) + (int)(get_local_id(0) / TILE);
#ifdef LISTS_IN_GLOBAL_MEMORY
    __global float *depths = spare_depths + get_group_id(0) * (size_t)capacity * PIXELS;
    __global int *tags = spare_tags + get_group_id(0) * (size_t)capacity * PIXELS;
#else
    __local float depths[CAPACITY * PIXELS];
    __local int tags[CAPACITY * PIXELS];
#endif
    const int found = collect(triangles, parts, whole, rest, entries, starts[tile], starts[tile + 1], corner, depths, tags, capacity);
    if (found > capacity)
        atomic_max(&needed[tile], found);
    const int count = min(found, capacity);
    sort_by_depth(depths, tags, count);
    const size_t own = get_local_id(1) * 2 * TILE + get_local_id(0);
    uint inside[WORDS];
    for (int word = 0; word < WORDS; ++word)
        inside[word] = 0u;
    float sum = 0.0f, from = 0.0f;
    for (int k = 0; k < count; ++k) {
        const float to = depths[(size_t)k * PIXELS + own];
        sum += attenuations[last_inside(inside)] * (to - from);
        from = to;
        pass_crossing(tags, k, inside);
    }
    const float3 ray = vload3(0, directions) * (float)column + vload3(1, directions) * (float)row + vload3(2, directions);
    if (column < pixels.x && row < pixels.y)
        image[(size_t)row * pixels.x + column] = sum * length(ray);
}
