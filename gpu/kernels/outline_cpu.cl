// The sum of maps under N silhouettes, by their outlines; see gpu/edges.py for what an outline is.
//
// One work-item takes particle after particle, and works on sixteen edges or sixteen rows at a time:
//   choose   edges that are outline from here and cross the centre of at least one row,
//   cross    them with the rows: per band of sixteen rows a stack of slots, each with one crossing per row (lane),
//   sort     the slots of a band, so that every row's crossings run from left to right,
//   walk     along them: where the winding becomes zero, or stops being zero, look the prefix sum up.
//
// Built with (gpu/outline_cpu.py): KEPT edges held between two passes, TALL rows up to which an edge's crossings are
// listed one by one, TALL_SLOTS and SHORT_SLOTS of a band: from the boundary between them, edges that have a slot for
// themselves go down, single crossings go up. BAND_STRIDE in slots has room for sorting, and is odd, so that the bands
// do not compete for the same lines of the cache.
//
// Coordinates are those of pixel centres: pixel (i, j) is the point (j, i). A crossing is one number that sorts by
// column, with its winding in the last eight bits.

typedef struct {
    __global float *x, *y, *slope;    // chosen edges: upper end, pixels per row
    __global int *rows;               // bottom << 16 | top << 3 | winding + 4
    __global int *short_row, *short_crossing;
    __global int *short_end;          // per row: where its next short crossing goes
    __global int *tall_first;         // per band: the slot of its last tall edge
    __global ints *slots;
    __global int *found;              // where a silhouette begins (odd) or ends: 2 * (lane * (width + 1) + column)
    int width, height, nothing;       // `nothing`: a crossing behind the last column that changes no winding
} Scratch;

static int bands_of(const int height) { return (height + LANES - 1) / LANES; }

static void empty_band(const Scratch s, const int band)
{
    s.tall_first[band] = band * BAND_STRIDE + TALL_SLOTS;
    ((__global ints *)s.short_end)[band] = (band * BAND_STRIDE + TALL_SLOTS) * LANES + lane_numbers();
}

static Scratch take_scratch(__global int *memory, const int width, const int height)
{
    const int bands = bands_of(height);
    Scratch s;
    s.width = width;
    s.height = height;
    s.nothing = (width + 1) << 8;
    s.slots = (__global ints *)memory;
    s.slots += KEPT;   // the first band may run under, the last one over, before it is noticed
    memory += (KEPT + bands * BAND_STRIDE + KEPT * TALL) * LANES;
    s.short_end = memory;
    memory += bands * LANES;
    s.tall_first = memory;
    memory += (bands + LANES) / LANES * LANES;
    s.x = (__global float *)memory;
    s.y = s.x + KEPT;
    s.slope = s.y + KEPT;
    s.rows = memory + 3 * KEPT;
    memory += 4 * KEPT;
    s.short_row = memory;
    s.short_crossing = s.short_row + KEPT * TALL + LANES;
    s.found = s.short_crossing + KEPT * TALL + LANES;
    for (int band = 0; band < bands; ++band) empty_band(s, band);
    return s;
}

static ints sign_of(floats v) { return (v < 0.0f) - (v > 0.0f); }

// Choose among sixteen edges; `block` has their ends and normals (gpu/clusters.py), `mask` the lanes to look at.
static int choose_edges(
    __global const floats *block, const int mask, __global const float *t, const float3 view, const Scratch s, int kept)
{
    const ints front_a = sign_of((block[6] * view.x + block[7] * view.y) + block[8] * view.z);
    const ints front_b = sign_of((block[9] * view.x + block[10] * view.y) + block[11] * view.z);
    const floats xa = ((block[0] * t[0] + block[1] * t[1]) + block[2] * t[2]) + (t[3] - 0.5f);
    const floats ya = ((block[0] * t[4] + block[1] * t[5]) + block[2] * t[6]) + (t[7] - 0.5f);
    const floats xb = ((block[3] * t[0] + block[4] * t[1]) + block[5] * t[2]) + (t[3] - 0.5f);
    const floats yb = ((block[3] * t[4] + block[4] * t[5]) + block[5] * t[6]) + (t[7] - 0.5f);
    const ints rising = ya > yb;
    const floats x = rising ? xb : xa, y = rising ? yb : ya, x_end = rising ? xa : xb, y_end = rising ? ya : yb;
    const ints top = first_from(y, s.height), bottom = first_from(y_end, s.height);
    const ints winding = rising ? front_b - front_a : front_a - front_b;
    const ints chosen = (winding != 0) & (bottom > top) & (((ints)mask & ((ints)1 << lane_numbers())) != 0);
    append_where(chosen, as_int16(x), (__global int *)s.x, kept);
    append_where(chosen, as_int16(y), (__global int *)s.y, kept);
    append_where(chosen, as_int16((x_end - x) / (y_end - y)), (__global int *)s.slope, kept);
    return append_where(chosen, bottom << 16 | top << 3 | (winding + 4), s.rows, kept);
}

static ints crossing(floats x, floats y, floats slope, ints row, ints winding, const int width)
{
    return first_from(x + (convert_float16(row) - y) * slope, width) << 8 | winding;
}

// One edge of many rows: a slot in every band that it passes.
static void cross_tall(const Scratch s, const int edge)
{
    const int rows = s.rows[edge], top = rows >> 3 & 0x1fff, bottom = rows >> 16, winding = ((rows & 7) - 4) & 255;
    const float x = s.x[edge], y = s.y[edge], slope = s.slope[edge];
    for (int band = top / LANES; band <= (bottom - 1) / LANES; ++band) {
        const ints row = band * LANES + lane_numbers();
        const int slot = s.tall_first[band] - 1;
        s.tall_first[band] = slot;
        s.slots[slot] = (row >= top) & (row < bottom) ? crossing(x, y, slope, row, winding, s.width) : s.nothing;
    }
}

static void cross_rows(const Scratch s, const int kept)
{
    int crossings = 0;
    for (int k = 0; k < kept; k += LANES) {
        const floats x = floats_at(s.x + k), y = floats_at(s.y + k), slope = floats_at(s.slope + k);
        const ints rows = ints_at(s.rows + k), winding = ((rows & 7) - 4) & 255;
        const ints bottom = k + lane_numbers() < kept ? rows >> 16 : 0;
        ints row = rows >> 3 & 0x1fff;
        const ints tall = bottom - row > TALL, end = tall ? 0 : bottom;
        while (lanes_where(row < end)) {
            append_where(row < end, row, s.short_row, crossings);
            crossings = append_where(
                row < end, crossing(x, y, slope, row, winding, s.width), s.short_crossing, crossings);
            row += 1;
        }
        for (uint left = lanes_where(tall); left; left &= left - 1) cross_tall(s, k + 31 - clz(left & -left));
    }
    for (int k = 0; k < crossings; ++k) {
        const uint row = s.short_row[k], end = s.short_end[row];
        s.short_end[row] = end + LANES;
        ((__global int *)s.slots)[end] = s.short_crossing[k];
    }
}

// Has some band more crossings than it has room for?
static bool overflowed(const Scratch s)
{
    ints full = 0;
    int least = 0;
    for (int band = 0; band < bands_of(s.height); ++band) {
        full |= ((__global ints *)s.short_end)[band] >= (band * BAND_STRIDE + TALL_SLOTS + SHORT_SLOTS) * LANES;
        least = min(least, s.tall_first[band] - band * BAND_STRIDE);
    }
    return least < 0 || lanes_where(full);
}

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

// Cross all parts of one particle with the rows. Returns whether they had room.
static bool draw_outline(
    __global const float *transforms, const int parts, __global const floats *blocks, __global const int *starts,
    __global const int2 *lists, const int across, const Scratch s)
{
    int kept = 0;
    for (int part = 0; part < parts; ++part) {
        __global const float *t = transforms + part * 12;
        const float3 view = cross((float3)(t[0], t[1], t[2]), (float3)(t[4], t[5], t[6]));
        __global const int *start = starts + part * 3 * across * across + cell_of(view, across);
        for (int k = start[0]; k < start[1]; ++k) {
            kept = choose_edges(blocks + lists[k].x * 12, lists[k].y, t, view, s, kept);
            if (kept > KEPT - 2 * LANES) {
                cross_rows(s, kept);
                kept = 0;
                if (overflowed(s)) return false;
            }
        }
    }
    cross_rows(s, kept);
    return !overflowed(s);
}

// Where silhouettes begin and end in a band's rows; returns how many such places were written to `found`.
static int walk_band(const Scratch s, const int band)
{
    const int boundary = band * BAND_STRIDE + TALL_SLOTS, first = s.tall_first[band];
    const ints end = ((__global ints *)s.short_end)[band];
    int last = boundary, found = 0;
    for (; lanes_where(end > last * LANES + lane_numbers()); ++last)
        s.slots[last] = end > last * LANES + lane_numbers() ? s.slots[last] : s.nothing;
    if (first == last) return 0;
    empty_band(s, band);
    __global ints *slots = s.slots + first;
    const int n = last - first;
    sort_lanes(slots, n, s.nothing);
    const ints line = lane_numbers() * (s.width + 1);
    ints winding = 0, inside = 0;
    for (int k = 0; k < n; ++k) {
        winding += slots[k] << 24 >> 24;
        const ints now_inside = winding != 0;
        const ints changed = now_inside ^ inside;
        if (lanes_where(changed))
            found = append_where(changed, ((line + (slots[k] >> 8)) << 1) - now_inside, s.found, found);
        inside = now_inside;
    }
    return found;
}

// scores (N, maps): the sum of each map, given as prefix sums along its rows (maps, height, width + 1).
// A particle without room gets LONG_MIN. `next` is zero at the start.
// With PLACED every particle has maps of its own frame: `prefix` holds many sets of them, `places` (N) says which.
__kernel void score(
    __global const float *transforms, const int particles, const int parts, __global const floats *blocks,
    __global const int *starts, __global const int2 *lists, const int across, __global const int *prefix,
    const int maps, const int width, const int height, __global long *scores, __global int *memory,
    const int memory_each, volatile __global int *next
#ifdef PLACED
    , __global const int *places
#endif
    )
{
    const Scratch s = take_scratch(memory + get_global_id(0) * (size_t)memory_each, width, height);
    const size_t map_size = (size_t)height * (width + 1);
    for (int n = atomic_inc(next); n < particles; n = atomic_inc(next)) {
        __global long *score = scores + (size_t)n * maps;
#ifdef PLACED
        __global const int *own = prefix + (size_t)places[n] * maps * map_size;
#else
        __global const int *own = prefix;
#endif
        const bool complete
            = draw_outline(transforms + (size_t)n * parts * 12, parts, blocks, starts, lists, across, s);
        for (int map = 0; map < maps; ++map) score[map] = complete ? 0 : LONG_MIN;
        for (int band = 0; band < bands_of(height); ++band) {
            if (!complete) {
                empty_band(s, band);
                continue;
            }
            const int found = walk_band(s, band);
            for (int map = 0; map < maps; ++map) {
                __global const int *lines = own + map * map_size + band * LANES * (width + 1);
                long sum = 0;
                for (int k = 0; k < found; ++k) {
                    const int value = lines[s.found[k] >> 1];
                    sum += s.found[k] & 1 ? -value : value;
                }
                score[map] += sum;
            }
        }
    }
}
