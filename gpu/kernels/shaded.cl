// Sunlit pictures of N posed bodies, with cast shadows. The readable twin is gpu/shaded_reference.py.
//
// One work-item takes pose after pose: draw the faces into a buffer of keys (depth and face in one number), draw them
// once more from the Sun (depth only), then give every sample that sees the body its light. A face's number is its place
// in the arrays of faces.
//
// Built with BIAS, the texels by which a face may lie deeper than the Sun's view says and be lit, and STEEPEST, beyond
// which a face is taken to be no steeper there.

#define BORDER 1.0f          // texels around the body in the Sun's view

typedef struct {
    int side, fine, stride;         // pixels, samples along one, and in memory
    int supersample, shadow, shadow_side, shadow_stride;
    int n_groups, n_gloss;
} Sizes;

typedef struct {
    __global int *keys;             // (fine, stride)
    __global float *map;            // (shadow_side, shadow_stride) depths from the Sun
    __global float *light;          // (padded): what a face shows where the Sun reaches it
    __global float *aside, *down;   // (padded): slopes of a face in the Sun's view
    __global float *gloss;          // (n_gloss, padded)
    __global float *row;            // (2, stride): sums of samples
} Room;

typedef struct {
    Matrix sun;                     // from the samples' space (column, row, depth) to the map's (column, row, depth)
    float3 towards, half_way;
    int shadows;                    // is there a map?
} Light;

#if defined(__AVX512F__) && defined(__has_builtin)
#if __has_builtin(__builtin_ia32_gathersiv16sf)
#define GATHER_IN_HARDWARE
#endif
#endif

#ifdef GATHER_IN_HARDWARE
typedef float native_floats __attribute__((vector_size(64)));
typedef int native_indices __attribute__((vector_size(64)));

static floats gather(__global const float *from, const ints index)
{
    const native_floats none = __builtin_astype((floats)0.0f, native_floats);
    const native_floats found = __builtin_ia32_gathersiv16sf(
        none, (const void *)(size_t)from, __builtin_astype(index, native_indices), (ushort)0xffff, 4);
    return __builtin_astype(found, floats);
}
#else
static floats gather(__global const float *from, const ints index)
{
    int at[LANES];
    float found[LANES];
    vstore16(index, 0, at);
    for (int k = 0; k < LANES; ++k) found[k] = from[at[k]];
    return vload16(0, found);
}
#endif

// The Sun's axes as rows: aside, down, and away from it.
static Matrix sun_axes(const float3 towards)
{
    const float3 away = -towards, y = {0.0f, 1.0f, 0.0f}, x = {1.0f, 0.0f, 0.0f};
    const float3 aside = normalize(cross(fabs(away.y) < 0.9f ? y : x, away)), down = cross(away, aside);
    const Matrix axes = {{aside.x, aside.y, aside.z, 0, down.x, down.y, down.z, 0, away.x, away.y, away.z, 0}};
    return axes;
}

// The Sun's view: `shadow` texels across the body's diameter, fewer where parts reach beyond it.
static Light light_of(const Body body, const Sizes sizes, __global const float *transforms, const float3 sun, int *rows)
{
    Light light;
    light.towards = normalize(sun);
    const float3 camera = {0.0f, 0.0f, -1.0f}, both = light.towards + camera;
    light.half_way = dot(both, both) > 1e-12f ? normalize(both) : (float3)0.0f;
    light.shadows = sizes.shadow > 0;
    light.sun = sun_axes(light.towards);
    if (!light.shadows) return light;
    const Range range = range_of(body, transforms, light.sun, sizes.supersample);
    const float wide = max(range.high[0] - range.low[0], range.high[1] - range.low[1]);
    const float across = 2.0f * body.radius * scale_of(part_matrix(transforms, sizes.supersample));
    const float zoom = sizes.shadow / max(max(wide, across), 1e-12f);
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) light.sun.m[4 * i + j] *= zoom;
        light.sun.m[4 * i + 3] = BORDER - zoom * range.low[i];
    }
    *rows = min((int)(zoom * (range.high[1] - range.low[1]) + 2.0f * BORDER) + 2, sizes.shadow_side);
    return light;
}

// Unit normals of sixteen faces, on the side that is seen.
static void normals_of(const Corners c, floats *n)
{
    const floats ax = c.x[1] - c.x[0], ay = c.y[1] - c.y[0], az = c.z[1] - c.z[0];
    const floats bx = c.x[2] - c.x[0], by = c.y[2] - c.y[0], bz = c.z[2] - c.z[0];
    n[0] = ay * bz - az * by;
    n[1] = az * bx - ax * bz;
    n[2] = ax * by - ay * bx;
    const floats square = n[0] * n[0] + n[1] * n[1] + n[2] * n[2];
    const floats length = sqrt(most_of(square, (floats)1e-30f));
    const floats per_length = (n[2] > 0.0f ? (floats)-1.0f : (floats)1.0f) / length;
    for (int k = 0; k < 3; ++k) n[k] *= per_length;
}

// What sixteen faces show in full light, and how they lie in the Sun's view. `share` NULL: planes are asked for.
static void light_faces(const Body body, const Sizes sizes, const Room room, const Light light, const Corners c,
    const int first, __global const float *exponents, __global const float *share)
{
    floats n[3];
    normals_of(c, n);
    const floats cosine = n[0] * light.towards.x + n[1] * light.towards.y + n[2] * light.towards.z;
    const ints facing = cosine > 0.0f;
    floats sum = facing ? cosine : 0.0f;
    if (share) {
        float albedo[LANES];
        for (int k = 0; k < LANES; ++k) albedo[k] = share[body.group[first + k]];
        sum *= vload16(0, albedo);
    }
    if (sizes.n_gloss > 0) {
        const floats towards = n[0] * light.half_way.x + n[1] * light.half_way.y + n[2] * light.half_way.z;
        const floats shine = towards > 0.0f ? towards : 0.0f;
        for (int k = 0; k < sizes.n_gloss; ++k) {
            const floats lobe = facing & (shine > 0.0f) ? powr(shine, (floats)exponents[k]) : 0.0f;
            if (share) {
                float strength[LANES];
                __global const float *of = share + sizes.n_groups * (1 + k) + 1;
                for (int j = 0; j < LANES; ++j) strength[j] = of[body.group[first + j]];
                sum += vload16(0, strength) * lobe;
            } else put(room.gloss + k * body.padded + first, lobe);
        }
    }
    put(room.light + first, sum);
    if (!light.shadows) return;
    const floats per_cosine = 1.0f / most_of(cosine, (floats)1e-6f);
    const float3 x = normalize((float3)(light.sun.m[0], light.sun.m[1], light.sun.m[2]));
    const float3 y = normalize((float3)(light.sun.m[4], light.sun.m[5], light.sun.m[6]));
    put(room.aside + first, clamp((n[0] * x.x + n[1] * x.y + n[2] * x.z) * per_cosine, -STEEPEST, STEEPEST));
    put(room.down + first, clamp((n[0] * y.x + n[1] * y.y + n[2] * y.z) * per_cosine, -STEEPEST, STEEPEST));
}

static void draw_from_sun(
    const Body body, const Sizes sizes, const Room room, const Light light, __global const float *transforms,
    const int rows)
{
    for (int row = 0; row < rows; ++row)
        for (int column = 0; column < sizes.shadow_side; column += LANES)
            put(room.map + row * sizes.shadow_stride + column, FAR_AWAY);
    Faces faces;
    for (int part = 0; part < body.parts; ++part) {
        const Matrix placed = after(light.sun, part_matrix(transforms + 12 * part, sizes.supersample));
        const float hand = handedness(placed);
        for (int first = LANES * body.start[part]; first < LANES * body.start[part + 1]; first += LANES) {
            const Corners c = corners_at(body, first, placed);
            const floats shut = hand * floats_at(body.shut + first);
            uint drawn = prepare(c, shut, sizes.shadow_side, rows, &faces);
            for (; drawn; drawn &= drawn - 1)
                draw_depth(&faces, 31 - clz(drawn & -drawn), sizes.shadow_side, room.map, sizes.shadow_stride, 0);
        }
    }
}

// How much of the Sun reaches sixteen samples: the comparison with the map's depths at the four texels around, each
// where the face's own plane meets it, between which it fades.
static floats reached(const Sizes sizes, const Room room, const Matrix sun, const int row, const int column,
    const floats depth, const ints face)
{
    const floats x = convert_float16(lane_numbers() + column);
    const float y = (float)row;
    floats u = sun.m[0] * x + (sun.m[2] * depth + (sun.m[1] * y + sun.m[3]));
    floats v = sun.m[4] * x + (sun.m[6] * depth + (sun.m[5] * y + sun.m[7]));
    const floats w = sun.m[8] * x + (sun.m[10] * depth + (sun.m[9] * y + sun.m[11] - BIAS));
    const floats most = (float)(sizes.shadow_side - 2);
    u = u > 0.0f ? u : 0.0f;
    u = u < most ? u : most;
    v = v > 0.0f ? v : 0.0f;
    v = v < most ? v : most;
    const ints i = convert_int16_rtz(v), j = convert_int16_rtz(u);
    const floats right = u - convert_float16(j), down = v - convert_float16(i);
    const floats aside = gather(room.aside, face), below = gather(room.down, face);
    const floats here = w - right * aside - down * below;
    const ints at = i * sizes.shadow_stride + j;
    const floats a = gather(room.map, at), b = gather(room.map + 1, at);
    const floats c = gather(room.map + sizes.shadow_stride, at), d = gather(room.map + sizes.shadow_stride + 1, at);
    const floats none = 0.0f, rest = 1.0f - right;
    const floats upper = (here <= a ? rest : none) + (here + aside <= b ? right : none);
    const floats lower = (here + below <= c ? rest : none) + (here + below + aside <= d ? right : none);
    return upper + down * (lower - upper);
}

static Room room_in(__global float *memory, const Body body, const Sizes sizes)
{
    Room room;
    room.keys = (__global int *)memory;
    room.map = memory + sizes.fine * sizes.stride;
    room.light = room.map + sizes.shadow_side * sizes.shadow_stride;
    room.aside = room.light + body.padded;
    room.down = room.aside + body.padded;
    room.gloss = room.down + body.padded;
    room.row = room.gloss + sizes.n_gloss * body.padded;
    return room;
}

// Adds up `supersample` samples for each pixel of a row, with what a sample counts.
static void give_row(const Sizes sizes, __global const float *sums, __global float *to, const float share)
{
    for (int j = 0; j < sizes.side; ++j) {
        float sum = 0.0f;
        for (int k = 0; k < sizes.supersample; ++k) sum += sums[j * sizes.supersample + k];
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
    const Range range = range_of(body, transforms, same, sizes.supersample);
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
            Corners deep = c;
            for (int k = 0; k < 3; ++k) deep.z[k] = clamp((c.z[k] - w.near) * w.steps, 0.0f, (float)DEEPEST(body));
            uint drawn = prepare(deep, hand * floats_at(body.shut + first), sizes.fine, sizes.fine, &faces);
            if (drawn && light) light_faces(body, sizes, room, *light, c, first, exponents, share);
            for (; drawn; drawn &= drawn - 1) {
                const int k = 31 - clz(drawn & -drawn);
                draw_key(&faces, k, sizes.fine, room.keys, sizes.stride, first + k, body.bits);
            }
        }
    }
}

// Adds sixteen samples to the planes of their groups and to their groups' lobes of gloss, `pixel` the first plane's row.
static void add_to_planes(const Body body, const Sizes sizes, const Room room, const int column, const ints face,
    const floats shown, const floats lit, __global float *pixel)
{
    const int pixels = sizes.side * sizes.side;
    int number[LANES];
    float bright[LANES], reach[LANES];
    vstore16(face, 0, number);
    vstore16(shown, 0, bright);
    vstore16(lit, 0, reach);
    for (int k = 0; k < LANES; ++k) {
        if (number[k] < 0 || bright[k] == 0.0f) continue;   // turned away from the Sun, or in shadow: no gloss either
        __global float *to = pixel + (column + k) / sizes.supersample;
        to[body.group[number[k]] * pixels] += bright[k];
        for (int g = 0; g < sizes.n_gloss; ++g)
            to[(sizes.n_groups * (1 + g) + 1 + body.group[number[k]]) * pixels] += reach[k] * room.gloss[g * body.padded + number[k]];
    }
}

// One pose, into zeros. With `share`, the weights of the planes: their sum into the first picture, and into a second,
// where there are two, the coverage. Without: every plane.
static void draw_pose(const Body body, const Sizes sizes, const Room room, __global const float *transforms,
    const float3 sun, __global const float *exponents, __global const float *share, const int pictures,
    __global float *out)
{
    const Window w = window_of(body, sizes, transforms);
    if (w.left >= w.right || w.top >= w.bottom) return;
    int map_rows = 0;
    const Light light = light_of(body, sizes, transforms, sun, &map_rows);
    draw_from_camera(body, sizes, room, w, transforms, &light, exponents, share);
    if (light.shadows) draw_from_sun(body, sizes, room, light, transforms, map_rows);
    const int pixels = sizes.side * sizes.side, step = sizes.supersample;
    const float each = 1.0f / (float)(step * step), per_step = w.steps > 0.0f ? 1.0f / w.steps : 0.0f;
    const float even = share ? share[sizes.n_groups] : 0.0f;
    __global float *sums = room.row, *covered = room.row + sizes.stride;
    const bool covers = !share || pictures > 1;
    __global float *coverage = out + (share ? 1 : sizes.n_groups) * pixels;
    for (int i = w.top / step; i < w.bottom / step; ++i) {
        clear(sums, sizes.stride);
        if (covers) clear(covered, sizes.stride);
        bool some = false;
        for (int row = i * step; row < (i + 1) * step; ++row)
            for (int column = w.left; column < w.right; column += LANES) {
                const ints key = ints_at(room.keys + row * sizes.stride + column), hit = key != EMPTY;
                if (!any_of(hit)) continue;
                some = true;
                const ints face = hit ? key & ((1 << body.bits) - 1) : 0;
                const floats full = hit ? gather(room.light, face) : 0.0f;
                const floats depth = w.near + (convert_float16(key >> body.bits) + 0.5f) * per_step;
                floats lit = 1.0f;
                if (light.shadows && any_of(full != 0.0f))
                    lit = reached(sizes, room, light.sun, row, column, depth, face);
                if (covers) put(covered + column, floats_at(covered + column) + (hit ? (floats)1.0f : 0.0f));
                if (share) put(sums + column, floats_at(sums + column) + (hit ? full * lit + even : 0.0f));
                else add_to_planes(body, sizes, room, column, hit ? face : -1, full * lit * each, lit * each,
                    out + i * sizes.side);
            }
        if (some && share) give_row(sizes, sums, out + i * sizes.side, each);
        if (some && covers) give_row(sizes, covered, coverage + i * sizes.side, each);
    }
}

#define BODY_GIVEN \
    __global const float *corners, __global const int *start, __global const int *group, __global const float *shut, \
    __global const float *boxes, const int parts, const int padded, const int bits, const float radius
#define SIZES_GIVEN \
    const int side, const int supersample, const int stride, const int shadow, const int shadow_side, \
    const int shadow_stride, const int n_groups, const int n_gloss
#define BODY {corners, start, group, shut, boxes, parts, padded, bits, radius}
#define SIZES \
    {side, side * supersample, stride, supersample, shadow, shadow_side, shadow_stride, n_groups, n_gloss}

// out (N, groups + 1 + groups * gloss, side, side)
__kernel void planes(
    __global const float *transforms, __global const float *suns, const int poses, BODY_GIVEN, SIZES_GIVEN,
    __global const float *exponents, __global float *out, __global float *memory, const int each,
    volatile __global int *next)
{
    const Body body = BODY;
    const Sizes sizes = SIZES;
    const Room room = room_in(memory + get_global_id(0) * (size_t)each, body, sizes);
    const size_t size = (size_t)(n_groups * (1 + n_gloss) + 1) * side * side;
    for (int pose = atomic_inc(next); pose < poses; pose = atomic_inc(next))
        draw_pose(body, sizes, room, transforms + (size_t)pose * parts * 12, vload3(pose, suns), exponents, 0, 0,
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
    const Room room = room_in(memory + get_global_id(0) * (size_t)each, body, sizes);
    for (int pose = atomic_inc(next); pose < poses; pose = atomic_inc(next))
        draw_pose(body, sizes, room, transforms + (size_t)pose * parts * 12, vload3(pose, suns), exponents,
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
