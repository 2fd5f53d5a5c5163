/* Which part does each voxel center lie in: parallel rays along z through the columns of a grid, one work-group a tile of (x, y), one
 * work-item a column. After mesh_hits.cl, built with LABEL (uchar or ushort). Depths are in voxels from the middle of the grid.
 *
 * layers: voxels along z. labels: (z, y, x), 0 outside, 1 + the last part that contains the center otherwise; a center exactly on a
 * surface belongs to what follows it along z, so that touching parts neither overlap nor leave a gap.
 */
__kernel __attribute__((reqd_work_group_size(2 * TILE, TILE / 2, 1)))
void label(__global const int *triangles, __global const int *parts, __global const int2 *whole, __global const float4 *rest,
           __global const uint *entries, __global const ulong *starts, __global const uint *listed, const int2 pixels, const int2 tiles,
           const int layers, __global int *needed, __global LABEL *labels,
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
    if (column >= pixels.x || row >= pixels.y)
        return;
    uint inside[WORDS];
    for (int word = 0; word < WORDS; ++word)
        inside[word] = 0u;
    const float middle = 0.5f * (float)(layers - 1);
    int k = 0;
    LABEL now = 0;
    for (int z = 0; z < layers; ++z) {
        while (k < count && depths[(size_t)k * PIXELS + own] <= (float)z - middle) {
            pass_crossing(tags, k, inside);
            now = (LABEL)last_inside(inside);
            ++k;
        }
        labels[((size_t)z * pixels.y + row) * pixels.x + column] = now;
    }
}
