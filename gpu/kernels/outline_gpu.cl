// The sum of maps under N silhouettes, by their outlines; see gpu/edges.py for what an outline is.
//
// One work-group takes particle after particle. Its work-items choose the outline edges together (into `chosen`), and
// then go down the image band by band: every edge adds its winding where it crosses a row, in local memory; each row's
// work-items add up a stretch of columns each, and walk along it from the winding that the stretches on their left
// leave. Nothing here has a limit on the number of crossings.
//
// Built with (gpu/outline_gpu.py): MAPS, BAND_ROWS, ROW_ITEMS (work-items per row; the group has BAND_ROWS times as
// many), STRETCH (columns per work-item; odd, so that neighbours use different banks of local memory).
//
// Coordinates are those of pixel centres: pixel (i, j) is the point (j, i).
#pragma OPENCL FP_CONTRACT OFF   // the reference rounds every product, so do we

#define LANES 16
#define GROUP (BAND_ROWS * ROW_ITEMS)
#define PITCH (STRETCH * ROW_ITEMS)

static int sign_of(const float v) { return (v > 0.0f) - (v < 0.0f); }

// The first of the points 0, 1, 2, ... that is not before v, at most `end`.
static int first_from(const float v, const int end) { return (int)ceil(fmin(fmax(v, 0.0f), (float)end)); }

// Which cell of directions (gpu/cells.py) a view belongs to.
static int cell_of(const float3 view, const int across)
{
    const float3 size = fabs(view);
    const int axis = size.x >= size.y && size.x >= size.z ? 0 : size.y >= size.z ? 1 : 2;
    const float3 turned = axis == 0 ? view : axis == 1 ? view.yzx : view.zxy;
    const float half_across = 0.5f * across, u = turned.y / turned.x, v = turned.z / turned.x;
    const int column = clamp((int)((u + 1.0f) * half_across), 0, across - 1);
    const int row = clamp((int)((v + 1.0f) * half_across), 0, across - 1);
    return (axis * across + row) * across + column;
}

// Look at one edge; if it is outline and crosses the centre of a row, append it: x, y, slope, rows and winding.
static void choose_edge(
    __global const float *block, const int lane, __global const float *t, const float3 view, const int height,
    __global float4 *chosen, volatile __local int *count)
{
    __global const float *e = block + lane;
    const int winding = sign_of((e[96] * view.x + e[112] * view.y) + e[128] * view.z)
        - sign_of((e[144] * view.x + e[160] * view.y) + e[176] * view.z);
    if (winding == 0) return;
    const float xa = ((e[0] * t[0] + e[16] * t[1]) + e[32] * t[2]) + (t[3] - 0.5f);
    const float ya = ((e[0] * t[4] + e[16] * t[5]) + e[32] * t[6]) + (t[7] - 0.5f);
    const float xb = ((e[48] * t[0] + e[64] * t[1]) + e[80] * t[2]) + (t[3] - 0.5f);
    const float yb = ((e[48] * t[4] + e[64] * t[5]) + e[80] * t[6]) + (t[7] - 0.5f);
    const bool rising = ya > yb;
    const float x = rising ? xb : xa, y = rising ? yb : ya, x_end = rising ? xa : xb, y_end = rising ? ya : yb;
    const int top = first_from(y, height), bottom = first_from(y_end, height);
    if (top >= bottom) return;
    const int rows = bottom << 16 | top << 3 | ((rising ? -winding : winding) + 4);
    chosen[atomic_inc(count)] = (float4)(x, y, (x_end - x) / (y_end - y), as_float(rows));
}

static void choose_edges(
    __global const float *transforms, const int parts, __global const float *blocks, __global const int *starts,
    __global const int2 *lists, const int across, const int height, __global float4 *chosen,
    volatile __local int *count)
{
    for (int part = 0; part < parts; ++part) {
        __global const float *t = transforms + part * 12;
        const float3 view = cross((float3)(t[0], t[1], t[2]), (float3)(t[4], t[5], t[6]));
        __global const int *start = starts + part * 3 * across * across + cell_of(view, across);
        const int lanes = (start[1] - start[0]) * LANES;
        for (int k = get_local_id(0); k < lanes; k += GROUP) {
            const int2 listed = lists[start[0] + k / LANES];
            if (listed.y >> k % LANES & 1)
                choose_edge(blocks + (size_t)listed.x * 12 * LANES, k % LANES, t, view, height, chosen, count);
        }
    }
}

// Add the windings of all crossings with the rows of a band.
static void cross_rows(
    __global const float4 *chosen, const int count, const int band, const int width, volatile __local int *winding)
{
    for (int k = get_local_id(0); k < count; k += GROUP) {
        const float4 edge = chosen[k];
        const int rows = as_int(edge.w);
        const int top = max(rows >> 3 & 0x1fff, band), bottom = min(rows >> 16, band + BAND_ROWS);
        for (int row = top; row < bottom; ++row) {
            const int column = first_from(edge.x + ((float)row - edge.y) * edge.z, width);
            atomic_add(winding + (row - band) * PITCH + column, (rows & 7) - 4);
        }
    }
}

// Walk along a stretch of a row and leave it empty; `sums` gains the maps' prefix sums where a silhouette ends, and
// loses them where it begins.
static void walk_row(
    volatile __local int *winding, __local int *stretches, __global const int *prefix, const size_t map_size,
    const int width, const bool inside_map, long *sums)
{
    const int row = get_local_id(0) / ROW_ITEMS, item = get_local_id(0) % ROW_ITEMS;
    volatile __local int *mine = winding + row * PITCH + item * STRETCH;
    int change = 0;
    for (int k = 0; k < STRETCH; ++k) change += mine[k];
    stretches[get_local_id(0)] = change;
    barrier(CLK_LOCAL_MEM_FENCE);
    int before = 0;
    for (int k = 0; k < item; ++k) before += stretches[row * ROW_ITEMS + k];
    for (int k = 0; k < STRETCH; ++k) {
        const int after = before + mine[k];
        mine[k] = 0;
        if ((before == 0) != (after == 0) && inside_map) {
            const size_t place = (size_t)row * (width + 1) + item * STRETCH + k;
            for (int map = 0; map < MAPS; ++map) {
                const long value = prefix[map * map_size + place];
                sums[map] += before ? value : -value;
            }
        }
        before = after;
    }
}

// scores (N, MAPS): the sum of each map, given as prefix sums along its rows (MAPS, height, width + 1). `memory` has
// room for `memory_each` edges per group, `winding` BAND_ROWS * PITCH numbers. `next` is zero at the start.
// With PLACED every particle has maps of its own frame: `prefix` holds many sets of them, `places` (N) says which.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1))) void score(
    __global const float *transforms, const int particles, const int parts, __global const float *blocks,
    __global const int *starts, __global const int2 *lists, const int across, __global const int *prefix,
    const int width, const int height, __global long *scores, __global float4 *memory, const int memory_each,
    volatile __global int *next, volatile __local int *winding
#ifdef PLACED
    , __global const int *places
#endif
    )
{
    __global float4 *chosen = memory + get_group_id(0) * (size_t)memory_each;
    __local int count, particle;
    __local int stretches[GROUP];
    __local long totals[GROUP];
    const size_t map_size = (size_t)height * (width + 1);
    const int me = get_local_id(0);
    for (int k = me; k < BAND_ROWS * PITCH; k += GROUP) winding[k] = 0;
    while (true) {
        if (me == 0) {
            particle = atomic_inc(next);
            count = 0;
        }
        barrier(CLK_LOCAL_MEM_FENCE);
        const int n = particle;
        if (n >= particles) break;
        choose_edges(transforms + (size_t)n * parts * 12, parts, blocks, starts, lists, across, height, chosen, &count);
        barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
#ifdef PLACED
        __global const int *own = prefix + (size_t)places[n] * MAPS * map_size;
#else
        __global const int *own = prefix;
#endif
        long sums[MAPS];
        for (int map = 0; map < MAPS; ++map) sums[map] = 0;
        for (int band = 0; band < height; band += BAND_ROWS) {
            cross_rows(chosen, count, band, width, winding);
            barrier(CLK_LOCAL_MEM_FENCE);
            const bool inside_map = band + me / ROW_ITEMS < height;
            walk_row(winding, stretches, own + (size_t)band * (width + 1), map_size, width, inside_map, sums);
            barrier(CLK_LOCAL_MEM_FENCE);
        }
        for (int map = 0; map < MAPS; ++map) {
            totals[me] = sums[map];
            barrier(CLK_LOCAL_MEM_FENCE);
            for (int half_group = GROUP / 2; half_group > 0; half_group /= 2) {
                if (me < half_group) totals[me] += totals[me + half_group];
                barrier(CLK_LOCAL_MEM_FENCE);
            }
            if (me == 0) scores[(size_t)n * MAPS + map] = totals[0];
            barrier(CLK_LOCAL_MEM_FENCE);
        }
    }
}
