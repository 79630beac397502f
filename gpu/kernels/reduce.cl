// The sum of a map under silhouettes that were drawn into the tiles of an atlas, one byte per pixel.
//
// One work-group per particle; its work-items share the rows of the tile. `tile_width` is a multiple of LANES.
// `origins` (N) are the tiles' corners in the image, `map` the image in whole units, `map_width` wide with its padding.
__kernel void sum_tiles(
    __global const uchar *atlas, const int atlas_width, const int tile_width, const int tile_height, const int across,
    __global const int2 *origins, __global const int *map, const int map_width, __global long *scores,
    __local long *totals)
{
    const int n = get_group_id(0), me = get_local_id(0), items = get_local_size(0);
    const int2 origin = origins[n];
    __global const uchar *tile = atlas + (size_t)(n / across) * tile_height * atlas_width + n % across * tile_width;
    long total = 0;
    for (int row = me; row < tile_height; row += items) {
        __global const uchar *covered = tile + (size_t)row * atlas_width;
        __global const int *values = map + (size_t)(origin.y + row) * map_width + origin.x;
        ints sum = 0;
        for (int column = 0; column < tile_width; column += LANES)
            sum += convert_int16(vload16(0, covered + column)) != 0 ? ints_at(values + column) : 0;
        const long8 eight = convert_long8(sum.lo) + convert_long8(sum.hi);
        const long4 four = eight.lo + eight.hi;
        total += four.x + four.y + four.z + four.w;
    }
    totals[me] = total;
    for (int half_group = items / 2; half_group > 0; half_group /= 2) {
        barrier(CLK_LOCAL_MEM_FENCE);
        if (me < half_group) totals[me] += totals[me + half_group];
    }
    if (me == 0) scores[n] = totals[0];
}
