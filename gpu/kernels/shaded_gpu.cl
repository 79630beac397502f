// Sunlit pictures of N posed bodies, with cast shadows: a work-group takes pose after pose. What it draws is what
// shaded.cl draws, which is made for a few strong cores; their twin is gpu/shaded_reference.py.
//
// The Sun's view is drawn tile by tile in local memory and copied to a map in the group's own memory. Then the camera's
// view is, and while a tile is there every item gives the samples of some pixels their light: a pixel has one owner,
// so sums need no atomics. Which item draws what changes nothing in the answer.

// Floats as ints that are in the same order.
static int ordered(const float v) { const int i = as_int(v); return i ^ (i >> 31 & 0x7fffffff); }
static float disordered(const int i) { return as_float(i ^ (i >> 31 & 0x7fffffff)); }

// What the body covers at most, along the camera's axes and along the Sun's: see range_of. The items share the parts.
static void find_ranges(const Body body, __global const float *transforms, const float supersample, const Matrix sun,
    volatile __local int *ends, Range *near, Range *lit)
{
    const int item = get_local_id(0);
    for (int k = item; k < 12; k += GROUP) ends[k] = ordered(k % 6 < 3 ? FAR_AWAY : -FAR_AWAY);
    barrier(CLK_LOCAL_MEM_FENCE);
    Range none = {{FAR_AWAY, FAR_AWAY, FAR_AWAY}, {-FAR_AWAY, -FAR_AWAY, -FAR_AWAY}};
    for (int part = item; part < body.parts; part += GROUP) {
        const Matrix placed = part_matrix(transforms + 12 * part, supersample);
        const Range one = widened(none, placed, body.boxes + 7 * part);
        const Range two = widened(none, after(sun, placed), body.boxes + 7 * part);
        for (int k = 0; k < 3; ++k) {
            atomic_min(ends + k, ordered(one.low[k]));
            atomic_max(ends + 3 + k, ordered(one.high[k]));
            atomic_min(ends + 6 + k, ordered(two.low[k]));
            atomic_max(ends + 9 + k, ordered(two.high[k]));
        }
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int k = 0; k < 3; ++k) {
        near->low[k] = disordered(ends[k]);
        near->high[k] = disordered(ends[3 + k]);
        lit->low[k] = disordered(ends[6 + k]);
        lit->high[k] = disordered(ends[9 + k]);
    }
}

// Whole pixels that a body in this range may cover.
static Window window_in(const Body body, const Sizes sizes, const Range range)
{
    const float last = (float)sizes.fine, deep = range.high[2] - range.low[2];
    const int step = sizes.supersample;
    Window w;
    w.tile.left = (int)clamp(range.low[0] - 1.0f, 0.0f, last) / step * step;
    w.tile.right = ((int)clamp(range.high[0] + 2.0f, 0.0f, last) + step - 1) / step * step;
    w.tile.top = (int)clamp(range.low[1] - 1.0f, 0.0f, last) / step * step;
    w.tile.bottom = ((int)clamp(range.high[1] + 2.0f, 0.0f, last) + step - 1) / step * step;
    w.near = range.low[2];
    w.steps = deep > 0.0f ? (float)DEEPEST(body) / deep : 0.0f;
    return w;
}

// Columns and rows of tiles, in whole squares of `step` samples.
static int2 tile_size(const Tile whole, const int step)
{
    const int columns = min(whole.right - whole.left, TILE / step / step * step);
    return (int2)(columns, min(TILE / max(columns, 1), TALLEST) / step * step);
}

static Tile tile_at(const Tile whole, const int2 size, const int top, const int left)
{
    const Tile tile = {top, min(top + size.y, whole.bottom), left, min(left + size.x, whole.right)};
    return tile;
}

// What a group draws a pose with and into.
typedef struct {
    Pose pose;
    Records records;
    Round round;
    __global float *map;            // (rows, columns) of the Sun's view
    int columns, rows;
} Group;

// How much of the Sun reaches a sample, in numbers of a face's record.
static float reaching_sample(const Body body, const Sizes sizes, const Group g, const int row, const int column,
    const int key, const float4 shown)
{
    if (!g.pose.light.shadows) return 1.0f;
    const Window w = g.pose.window;
    const float depth = w.near + ((float)(key >> body.bits) + 0.5f) * (w.steps > 0.0f ? 1.0f / w.steps : 0.0f);
    return reaching(sizes, g.pose.light.sun, g.map, g.columns, g.rows, (float)column, (float)row, depth, shown.y,
        shown.z);
}

// The sum of the planes times their weights, and with two `pictures` the coverage, at one pixel.
static void sum_pixel(const Body body, const Sizes sizes, const Group g, const Tile tile, const int row,
    const int column, const int pictures, __global float *to)
{
    const int step = sizes.supersample, across = tile.right - tile.left, mask = (1 << body.bits) - 1;
    float sum = 0.0f, covered = 0.0f;
    for (int i = row; i < row + step; ++i)
        for (int j = column; j < column + step; ++j) {
            const int key = g.round.samples[(i - tile.top) * across + j - tile.left], face = key & mask;
            if (key == EMPTY) continue;
            const float4 shown = g.records.faces[2 * face];
            covered += 1.0f;
            sum += g.records.faces[2 * face + 1].x;
            if (shown.x != 0.0f) sum += shown.x * reaching_sample(body, sizes, g, i, j, key, shown);
        }
    const float each = 1.0f / (float)(step * step);
    to[0] = each * sum;
    if (pictures > 1) to[sizes.side * sizes.side] = each * covered;
}

// Every plane at one pixel; those of groups and of gloss are zero before. Neighbours of one group are added at once.
static void give_pixel(const Body body, const Sizes sizes, const Group g, const Tile tile, const int row,
    const int column, __global float *to)
{
    const int step = sizes.supersample, across = tile.right - tile.left, mask = (1 << body.bits) - 1;
    const int pixels = sizes.side * sizes.side;
    const float each = 1.0f / (float)(step * step);
    float sum = 0.0f, covered = 0.0f;
    float3 normal = 0.0f;
    int group = 0;
    for (int i = row; i < row + step; ++i)
        for (int j = column; j < column + step; ++j) {
            const int key = g.round.samples[(i - tile.top) * across + j - tile.left], face = key & mask;
            if (key == EMPTY) continue;
            const float4 shown = g.records.faces[2 * face], n = g.records.faces[2 * face + 1];
            covered += each;
            normal += each * n.xyz;
            if (shown.x == 0.0f && n.w == 0.0f) continue;
            const int own = as_int(shown.w);
            if (own != group && sum != 0.0f) {
                to[PAINT_OF(group) * pixels] += sum;
                sum = 0.0f;
            }
            group = own;
            sum += each * n.w;
            if (shown.x == 0.0f) continue;
            const float lit = each * reaching_sample(body, sizes, g, i, j, key, shown);
            if (lit == 0.0f) continue;   // in shadow: no gloss
            sum += lit * shown.x;
            for (int k = 0; k < sizes.n_gloss; ++k) {
                const float shine = lit * g.records.gloss[k * body.padded + face];
                if (shine != 0.0f) to[LOBE(sizes, k, SHINE_OF(own)) * pixels] += shine;
            }
        }
    if (sum != 0.0f) to[PAINT_OF(group) * pixels] += sum;
    to += sizes.n_groups * pixels;
    to[0] = covered;
    to[pixels] = normal.x;
    to[2 * pixels] = normal.y;
    to[3 * pixels] = normal.z;
}

// What a whole tile is for: the Sun's view goes to the map, faces that the camera sees are marked, if there are any
// `marks`, or else pixels get their light.
static void use_tile(const Body body, const Sizes sizes, const Group g, const Tile tile, const bool from_sun,
    const int pictures, __global float *out, __global uchar *marks)
{
    const int item = get_local_id(0), step = sizes.supersample, across = tile.right - tile.left;
    const int count = (tile.bottom - tile.top) * across, wide = across / step;
    if (from_sun) {
        for (int k = item; k < count; k += GROUP)
            g.map[(tile.top + k / across) * g.columns + tile.left + k % across] = as_float(g.round.samples[k]);
        return;
    }
    if (marks) {
        for (int k = item; k < count; k += GROUP)
            if (g.round.samples[k] != EMPTY) marks[g.round.samples[k] & ((1 << body.bits) - 1)] = 1;
        return;
    }
    for (int k = item; k < (tile.bottom - tile.top) / step * wide; k += GROUP) {
        const int row = tile.top + k / wide * step, column = tile.left + k % wide * step;
        __global float *to = out + row / step * sizes.side + column / step;
        if (g.records.share) sum_pixel(body, sizes, g, tile, row, column, pictures, to);
        else give_pixel(body, sizes, g, tile, row, column, to);
    }
}

// One pose: with weights of planes (`records.share`) the sums in `pictures` pictures, without them every plane; or
// with `marks` nothing but which faces are seen.
static void draw_pose_together(const Body body, const Sizes sizes, Group g, const float3 sun, const int pictures,
    volatile __local int *ends, __global float *out, __global uchar *marks)
{
    const int step = sizes.supersample, side = sizes.side;
    const int planes = g.records.share ? pictures : LOBE(sizes, sizes.n_gloss, 0);
    if (!marks)
        for (int k = get_local_id(0); k < planes * side * side; k += GROUP) out[k] = 0.0f;
    Range near, lit;
    find_ranges(body, g.pose.transforms, step, sun_axes(normalize(sun)), ends, &near, &lit);
    g.pose.window = window_in(body, sizes, seen_range(near, sizes));
    const float scale = scale_of(part_matrix(g.pose.transforms, step));
    g.pose.light = light_in(body, sizes, lit, scale, sun, &g.columns, &g.rows);
    const Tile seen = g.pose.window.tile, map = {0, g.rows, 0, g.columns};
    if (seen.left >= seen.right || seen.top >= seen.bottom) return;
    for (int view = g.pose.light.shadows ? 0 : 1; view < 2; ++view) {
        const bool from_sun = view == 0;
        const Tile whole = from_sun ? map : seen;
        const int2 size = tile_size(whole, from_sun ? 1 : step);
        for (int top = whole.top; top < whole.bottom; top += size.y)
            for (int left = whole.left; left < whole.right; left += size.x) {
                const Tile tile = tile_at(whole, size, top, left);
                draw_tile(body, sizes, g.pose, tile, from_sun, g.round, g.records);
                use_tile(body, sizes, g, tile, from_sun, pictures, out, marks);
                barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
            }
    }
}

#define BODY {corners, start, group, shut, boxes, parts, padded, bits, radius}
#define SIZES \
    {side, side * supersample, 0, supersample, shadow, shadow_side, 0, n_groups, n_shiny, n_gloss, lens, \
        middle_x, middle_y, {around_x, around_y, around_z, around}}
// A barrier comes before an item asks for the next pose: in every pose there is one.
#define NEXT_POSE(pose) \
    if (get_local_id(0) == 0) taken = atomic_inc(next); \
    barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE); \
    pose = taken;

// out (N, pictures, side, side); share: `every` numbers from one pose's weights to the next's, 0 if all are drawn
// alike. With no `pictures` out is (N, groups + EVEN_PLANES + shiny * gloss, side, side). With `marks` (padded), zeros
// before, the faces that are nearest to some sample in some pose are marked, and that is all.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1))) void draw(
    __global const float *transforms, __global const float *suns, const int poses,
    __global const float *corners, __global const int *start, __global const int *group, __global const float *shut,
    __global const float *boxes, const int parts, const int padded, const int bits, const float radius,
    const int side, const int supersample, const int shadow, const int shadow_side, const int n_groups,
    const int n_shiny, const int n_gloss, const float lens, const float middle_x, const float middle_y,
    const float around_x, const float around_y, const float around_z, const float around,
    __global const float *exponents, __global float *out, __global float *memory, const int each,
    volatile __global int *next, __global const float *share, const int every, const int pictures,
    __global uchar *marks)
{
    __local float numbers[11 * GROUP];
    __local int begin[GROUP], place[GROUP], shape[GROUP], number[GROUP], samples[TILE], ends[12], taken;
    __local uint filled;
    const Round round = {numbers, begin, place, shape, number, &filled, samples};
    const Body body = BODY;
    const Sizes sizes = SIZES;
    const size_t size = (size_t)(pictures > 0 ? pictures : LOBE(sizes, n_gloss, 0)) * side * side;
    Group g;
    memory += get_group_id(0) * (size_t)each;
    g.round = round;
    g.records.faces = marks ? 0 : (__global float4 *)memory;
    g.records.gloss = memory + 8 * padded;
    g.records.exponents = exponents;
    g.map = g.records.gloss + n_gloss * padded;
    int pose;
    NEXT_POSE(pose)
    while (pose < poses) {
        g.pose.transforms = transforms + (size_t)pose * parts * 12;
        g.records.share = pictures > 0 ? share + (size_t)pose * every : 0;
        draw_pose_together(body, sizes, g, vload3(pose, suns), pictures, ends, out + pose * size, marks);
        NEXT_POSE(pose)
    }
}
