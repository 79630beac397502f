// Sunlit pictures of N posed bodies, with cast shadows. The readable twin is gpu/shaded_reference.py.
//
// One work-item takes pose after pose: draw the faces into a buffer of keys (depth and face in one number), draw them
// once more from the Sun (depth only), then give every sample that sees the body its light. A face's number is its
// place in the arrays of faces.

static Room room_in(__global float *memory, const Body body, const Sizes sizes)
{
    Room room;
    room.keys = (__global int *)memory;
    room.map = memory + sizes.fine * sizes.stride;
    room.light = room.map + sizes.shadow_side * sizes.shadow_stride;
    room.even = room.light + body.padded;
    room.aside = room.even + 3 * body.padded;
    room.down = room.aside + body.padded;
    room.gloss = room.down + body.padded;
    room.row = room.gloss + sizes.n_gloss * body.padded;
    return room;
}

// The part of a patch that is kept of its pictures. In samples its columns are whole lanes.
typedef struct { int top, left, rows, columns; } Cut;

// Adds up `supersample` samples for each pixel of a row, with what a sample counts. `to` is the row of the cut.
static void give_row(const Sizes sizes, const Cut cut, __global const float *sums, __global float *to,
    const float share)
{
    for (int j = 0; j < cut.columns; ++j) {
        float sum = 0.0f;
        for (int k = 0; k < sizes.supersample; ++k) sum += sums[(cut.left + j) * sizes.supersample + k];
        to[j] = share * sum;
    }
}

static void clear(__global float *to, const int count)
{
    int k = 0;
    for (; k + LANES <= count; k += LANES) put(to + k, 0.0f);
    for (; k < count; ++k) to[k] = 0.0f;
}

// The samples that the body may cover, and how many steps of depth a sample is long in keys.
typedef struct { float near, steps; int left, right, top, bottom; } Window;

static Window window_of(const Body body, const Sizes sizes, __global const float *transforms)
{
    const Matrix same = {{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0}};
    const Range range = seen_range(range_of(body, transforms, same, sizes.supersample), sizes);
    const float last = (float)sizes.fine, deep = range.high[2] - range.low[2];
    const int step = sizes.supersample;
    Window w;
    w.left = (int)clamp(range.low[0] - 1.0f, 0.0f, last) & -LANES;
    w.right = (int)clamp(range.high[0] + 2.0f, 0.0f, last);
    w.top = (int)clamp(range.low[1] - 1.0f, 0.0f, last) / step * step;
    w.bottom = ((int)clamp(range.high[1] + 2.0f, 0.0f, last) + step - 1) / step * step;
    w.near = range.low[2];
    w.steps = deep > 0.0f ? (float)DEEPEST(body) / deep : 0.0f;
    return w;
}

// The nearest face of every sample; with `light`, also what the faces that may be seen show of it.
static void draw_from_camera(const Body body, const Sizes sizes, const Room room, const Window w,
    __global const float *transforms, const Light *light, __global const float *exponents, __global const float *share)
{
    for (int row = w.top; row < w.bottom; ++row)
        for (int column = w.left; column < w.right; column += LANES)
            put_ints(room.keys + row * sizes.stride + column, EMPTY);
    Faces faces;
    for (int part = 0; part < body.parts; ++part) {
        const Matrix placed = part_matrix(transforms + 12 * part, sizes.supersample);
        const float hand = handedness(placed);
        for (int first = LANES * body.start[part]; first < LANES * body.start[part + 1]; first += LANES) {
            const Corners c = corners_at(body, first, placed);
            Corners deep = through_lens(c, sizes);
            for (int k = 0; k < 3; ++k) deep.z[k] = clamp((deep.z[k] - w.near) * w.steps, 0.0f, (float)DEEPEST(body));
            uint drawn = prepare(deep, hand * floats_at(body.shut + first), sizes.fine, sizes.fine, &faces);
            if (drawn && light) light_faces(body, sizes, room, *light, c, first, exponents, share);
            for (; drawn; drawn &= drawn - 1) {
                const int k = 31 - clz(drawn & -drawn);
                draw_key(&faces, k, sizes.fine, room.keys, sizes.stride, first + k, body.bits);
            }
        }
    }
}

// Adds sixteen samples to the planes of their groups and to their groups' lobes of gloss; neighbours of one group and
// pixel at once. `pixel` is the first plane's row, `pixels` are from one plane to the next.
static void add_to_planes(const Body body, const Sizes sizes, const Room room, const int column, const ints face,
    const floats shown, const floats shone, const floats lit, __global float *pixel, const int pixels)
{
    const int count = min(LANES, sizes.fine - column);
    int number[LANES];
    float bright[LANES], direct[LANES], reach[LANES];
    vstore16(face, 0, number);
    vstore16(shown, 0, bright);
    vstore16(shone, 0, direct);
    vstore16(lit, 0, reach);
    __global float *to = pixel + column / sizes.supersample;
    for (int k = 0, end = sizes.supersample - column % sizes.supersample; k < count; ++to, end += sizes.supersample)
        while (k < min(end, count)) {
            if (number[k] < 0 || bright[k] == 0.0f) { ++k; continue; }
            const int first = k, group = body.group[number[k]];
            float sum = 0.0f, sunlit = 0.0f;
            for (; k < min(end, count) && number[k] >= 0 && body.group[number[k]] == group; ++k) {
                sum += bright[k];
                sunlit += direct[k];
            }
            to[PAINT_OF(group) * pixels] += sum;
            if (sunlit == 0.0f) continue;  // away from the Sun, or in shadow: no gloss
            for (int g = 0; g < sizes.n_gloss; ++g) {
                __global const float *gloss = room.gloss + g * body.padded;
                float shine = 0.0f;
                for (int j = first; j < k; ++j) shine += direct[j] == 0.0f ? 0.0f : reach[j] * gloss[number[j]];
                to[LOBE(sizes, g, SHINE_OF(group)) * pixels] += shine;
            }
        }
}

// One pose's cut, into zeros. With `share`, the weights of the planes: their sum into the first picture, and into a
// second, where there are two, the coverage. Without: every plane.
static void draw_pose(const Body body, const Sizes sizes, const Cut cut, const Room room,
    __global const float *transforms, const float3 sun, __global const float *exponents, __global const float *share,
    const int pictures, __global float *out)
{
    const Window w = window_of(body, sizes, transforms);
    if (w.left >= w.right || w.top >= w.bottom) return;
    int map_rows = 0;
    const Light light = light_of(body, sizes, transforms, sun, &map_rows);
    draw_from_camera(body, sizes, room, w, transforms, &light, exponents, share);
    if (light.shadows) draw_from_sun(body, sizes, room, light, transforms, map_rows);
    const int pixels = cut.rows * cut.columns, step = sizes.supersample;
    const int left = max(w.left, cut.left * step), right = min(w.right, (cut.left + cut.columns) * step);
    const float each = 1.0f / (float)(step * step), per_step = w.steps > 0.0f ? 1.0f / w.steps : 0.0f;
    __global float *sums = room.row, *covered = room.row + sizes.stride;
    const int means = share ? (pictures > 1 ? 1 : 0) : EVEN_PLANES;  // of the coverage, and of normals
    __global float *coverage = out + (share ? 1 : sizes.n_groups) * pixels;
    for (int i = max(w.top / step, cut.top); i < min(w.bottom / step, cut.top + cut.rows); ++i) {
        const int from = (i - cut.top) * cut.columns;
        clear(sums, sizes.stride);
        clear(covered, means * sizes.stride);
        bool some = false;
        for (int row = i * step; row < (i + 1) * step; ++row)
            for (int column = left; column < right; column += LANES) {
                const ints key = ints_at(room.keys + row * sizes.stride + column), hit = key != EMPTY;
                if (!any_of(hit)) continue;
                some = true;
                const ints face = hit ? key & ((1 << body.bits) - 1) : 0;
                const floats full = hit ? gather(room.light, face) : 0.0f;
                const floats depth = w.near + (convert_float16(key >> body.bits) + 0.5f) * per_step;
                floats lit = 1.0f;
                if (light.shadows && any_of(full != 0.0f))
                    lit = reached(sizes, room, light.sun, row, column, depth, face);
                floats mean[EVEN_PLANES];  // coverage, and the normal
                for (int k = 0; k < means; ++k) {
                    __global float *to = covered + k * sizes.stride + column;
                    mean[k] = k == 0 ? (floats)1.0f : gather(room.even + (k - 1) * body.padded, face);
                    put(to, floats_at(to) + (hit ? mean[k] : 0.0f));
                }
                const floats even = share ? gather(room.even, face) : 0.0f;
                if (share) put(sums + column, floats_at(sums + column) + (hit ? full * lit + even : 0.0f));
                else {
                    const floats around = hit ? from_around(sizes, mean[1], mean[2], mean[3]) : 0.0f;
                    add_to_planes(body, sizes, room, column, hit ? face : -1, (full * lit + around) * each,
                        full * lit * each, lit * each, out + from - cut.left, pixels);
                }
            }
        if (some && share) give_row(sizes, cut, sums, out + from, each);
        for (int k = 0; some && k < means; ++k)
            give_row(sizes, cut, covered + k * sizes.stride, coverage + k * pixels + from, each);
    }
}

#define BODY_GIVEN \
    __global const float *corners, __global const int *start, __global const int *group, __global const float *shut, \
    __global const float *boxes, const int parts, const int padded, const int bits, const float radius
#define SIZES_GIVEN \
    const int side, const int supersample, const int stride, const int shadow, const int shadow_side, \
    const int shadow_stride, const int n_groups, const int n_shiny, const int n_gloss, const float lens, \
    const float middle_x, const float middle_y, const float around_x, const float around_y, const float around_z, \
    const float around
#define BODY {corners, start, group, shut, boxes, parts, padded, bits, radius}
#define SIZES \
    {side, side * supersample, stride, supersample, shadow, shadow_side, shadow_stride, n_groups, n_shiny, n_gloss, \
        lens, middle_x, middle_y, {around_x, around_y, around_z, around}}

// out (N, groups + EVEN_PLANES + shiny * gloss, rows, columns)
__kernel void planes(
    __global const float *transforms, __global const float *suns, const int poses, BODY_GIVEN, SIZES_GIVEN,
    __global const float *exponents, __global float *out, __global float *memory, const int each,
    volatile __global int *next, const int top, const int left, const int rows, const int columns)
{
    const Body body = BODY;
    const Sizes sizes = SIZES;
    const Cut cut = {top, left, rows, columns};
    const Room room = room_in(memory + get_global_id(0) * (size_t)each, body, sizes);
    const size_t size = (size_t)LOBE(sizes, n_gloss, 0) * rows * columns;
    for (int pose = atomic_inc(next); pose < poses; pose = atomic_inc(next))
        draw_pose(body, sizes, cut, room, transforms + (size_t)pose * parts * 12, vload3(pose, suns), exponents, 0, 0,
            out + pose * size);
}

// out (N, pictures, side, side); share: `every` numbers from one pose's weights to the next's, 0 if all are drawn alike
__kernel void combined(
    __global const float *transforms, __global const float *suns, const int poses, BODY_GIVEN, SIZES_GIVEN,
    __global const float *exponents, __global float *out, __global float *memory, const int each,
    volatile __global int *next, __global const float *share, const int every, const int pictures)
{
    const Body body = BODY;
    const Sizes sizes = SIZES;
    const Cut whole = {0, 0, side, side};
    const Room room = room_in(memory + get_global_id(0) * (size_t)each, body, sizes);
    for (int pose = atomic_inc(next); pose < poses; pose = atomic_inc(next))
        draw_pose(body, sizes, whole, room, transforms + (size_t)pose * parts * 12, vload3(pose, suns), exponents,
            share + (size_t)pose * every, pictures, out + (size_t)pose * pictures * side * side);
}

// Marks the faces that are nearest to some sample in some pose. marks (padded), 0 before.
__kernel void mark_seen(
    __global const float *transforms, const int poses, BODY_GIVEN, SIZES_GIVEN, __global uchar *marks,
    __global float *memory, const int each, volatile __global int *next)
{
    const Body body = BODY;
    const Sizes sizes = SIZES;
    const Room room = room_in(memory + get_global_id(0) * (size_t)each, body, sizes);
    for (int pose = atomic_inc(next); pose < poses; pose = atomic_inc(next)) {
        __global const float *placed = transforms + (size_t)pose * parts * 12;
        const Window w = window_of(body, sizes, placed);
        draw_from_camera(body, sizes, room, w, placed, 0, 0, 0);
        for (int row = w.top; row < w.bottom; ++row)
            for (int column = w.left; column < min(w.right, sizes.fine); ++column) {
                const int key = room.keys[row * sizes.stride + column];
                if (key != EMPTY) marks[key & ((1 << body.bits) - 1)] = 1;
            }
    }
}
