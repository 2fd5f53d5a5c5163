/* Which part does each voxel center lie in: parallel rays along z through the columns of a grid, one work-group a tile of (x, y), one
 * work-item a column. After mesh_crossings.cl, built with LABEL (uchar or ushort). Depths are in voxels from the middle of the grid.
 *
 * layers: voxels along z. labels: (z, y, x), 0 outside, 1 + the last part that contains the center otherwise; a center exactly on a
 * surface belongs to what follows it along z, so that touching parts neither overlap nor leave a gap.
 */
void fill_column(const LIST float *depths, const LIST int *tags, const int count, const int layers, const size_t layer_size,
                 __global LABEL *column)
{
    const float middle = 0.5f * (float)(layers - 1);
    Place place;
    start_outside(&place);
    int k = 0;
    LABEL now = 0;
    for (int z = 0; z < layers; ++z) {
        while (k < count && depths[(size_t)k * PIXELS] <= (float)z - middle) {
            pass_counting(&place, tags, k);
            now = (LABEL)last_inside(&place);
            ++k;
        }
        column[z * layer_size] = now;
    }
}

__kernel __attribute__((reqd_work_group_size(BAND, GROUP_BANDS, 1)))
void label(__global const int *triangles, __global const int *parts, __global const int2 *whole, __global const float4 *rest,
           __global const uint *entries, __global const ulong *starts, __global const uint *listed, const int2 pixels, const int2 tiles,
           const int layers, __global int *needed, __global LABEL *labels,
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
        if (pixel.x < pixels.x && pixel.y < pixels.y)
            fill_column(depths + first, tags + first, count, layers, (size_t)pixels.x * pixels.y, labels + (size_t)pixel.y * pixels.x + pixel.x);
    }
}
