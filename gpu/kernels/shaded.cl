// Sunlit pictures of N posed bodies, with cast shadows. The readable twin is gpu/shaded_reference.py.
//
// One work-item takes pose after pose: draw the faces into a buffer of keys (depth and face in one number), draw them
// once more from the Sun (depth only), then give every sample that sees the body its light. Faces come as corners,
// sixteen side by side, those of a part together, so that nothing is looked up by index: a corner is moved as often as
// faces share it, which is cheaper than to gather it. Coordinates count samples, and sample (i, j) is the point (j, i).
// A face's number is its place in these arrays.
//
// Built with BIAS, the texels by which a face may lie deeper than the Sun's view says and be lit, and STEEPEST, beyond
// which a face is taken to be no steeper there.

#pragma OPENCL FP_CONTRACT ON

#define EMPTY 0x7fffffff
#define FAR_AWAY 1e30f
#define LEAST_AREA 1e-6f     // a face smaller than this, in samples, is seen edge-on
#define LEAST_RISE 1e-6f     // an edge lower than this is level
#define LEAST_RUN 1e-5f      // before an edge on the right, its side is its neighbour's
#define NARROW 32            // samples up to which a face's rows are tested whole
#define BORDER 1.0f          // texels around the body in the Sun's view

#define least_of(a, b) ((a) < (b) ? (a) : (b))
#define most_of(a, b) ((a) > (b) ? (a) : (b))

typedef struct {
    __global const float *corners;  // (9, padded): x, y, z of the first corners, of the second, of the third
    __global const int *start;      // (parts + 1): of a part's faces, in sixteens
    __global const int *group;      // (padded)
    __global const float *shut;     // (padded) 1 or -1: of a closed piece, its front side; 0: both sides are seen
    __global const float *boxes;    // (parts, 7): centre, half extents, radius of each part at rest
    int parts, padded, bits;        // bits: of a face's number in a key
    float radius;                   // of the body
} Body;

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

typedef struct { float m[12]; } Matrix;   // (3, 4)

typedef struct {
    Matrix sun;                     // from the samples' space (column, row, depth) to the map's (column, row, depth)
    float3 towards, half_way;
    int shadows;                    // is there a map?
} Light;

typedef struct { float low[3], high[3]; } Range;

// Sixteen faces, ready to be drawn: rows and columns, three edges, and the plane of depth. A sample in column x of row
// top + r lies on an edge's inner side where side x + from + r step is not negative.
typedef struct {
    int top[LANES], bottom[LANES], left[LANES], right[LANES];
    float side[3][LANES], from[3][LANES], step[3][LANES];
    float z[LANES], right_z[LANES], down_z[LANES], near[LANES], far[LANES];
} Faces;

typedef struct { floats x[3], y[3], z[3]; } Corners;

static void put(__global float *to, const floats values) { *(__global loose_floats *)to = values; }
static void put_ints(__global int *to, const ints values) { *(__global loose_ints *)to = values; }

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

static bool any_of(const ints chosen) { return lanes_where(chosen) != 0; }

// a after b, both (3, 4).
static Matrix after(const Matrix a, const Matrix b)
{
    Matrix c;
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 4; ++j)
            c.m[4 * i + j] = a.m[4 * i] * b.m[j] + a.m[4 * i + 1] * b.m[4 + j] + a.m[4 * i + 2] * b.m[8 + j]
                + (j == 3 ? a.m[4 * i + 3] : 0.0f);
    return c;
}

// Of a part: body point -> samples; its depth is counted in samples too.
static Matrix part_matrix(__global const float *transform, const float supersample)
{
    Matrix c;
    for (int k = 0; k < 12; ++k) c.m[k] = supersample * transform[k];
    c.m[3] -= 0.5f;
    c.m[7] -= 0.5f;
    return c;
}

static float scale_of(const Matrix a)
{
    float sum = 0.0f;
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) sum += a.m[4 * i + j] * a.m[4 * i + j];
    return sqrt(sum / 3.0f);
}

static float handedness(const Matrix a)
{
    const float3 x = {a.m[0], a.m[1], a.m[2]}, y = {a.m[4], a.m[5], a.m[6]}, z = {a.m[8], a.m[9], a.m[10]};
    return dot(cross(x, y), z) < 0.0f ? -1.0f : 1.0f;
}

// What a part's bounding box or sphere covers at most, whichever is less.
static Range widened(Range range, const Matrix a, __global const float *box)
{
    const float most = scale_of(a) * box[6] * 1.00001f;
    for (int i = 0; i < 3; ++i) {
        const float *row = a.m + 4 * i;
        const float middle = row[0] * box[0] + row[1] * box[1] + row[2] * box[2] + row[3];
        const float reach = fabs(row[0]) * box[3] + fabs(row[1]) * box[4] + fabs(row[2]) * box[5];
        const float half_range = min(reach, most);
        range.low[i] = min(range.low[i], middle - half_range);
        range.high[i] = max(range.high[i], middle + half_range);
    }
    return range;
}

static Range range_of(const Body body, __global const float *transforms, const Matrix then, const float supersample)
{
    Range range = {{FAR_AWAY, FAR_AWAY, FAR_AWAY}, {-FAR_AWAY, -FAR_AWAY, -FAR_AWAY}};
    for (int part = 0; part < body.parts; ++part)
        range = widened(range, after(then, part_matrix(transforms + 12 * part, supersample)), body.boxes + 7 * part);
    return range;
}

static Corners corners_at(const Body body, const int first, const Matrix a)
{
    Corners c;
    for (int k = 0; k < 3; ++k) {
        __global const float *at = body.corners + 3 * k * body.padded + first;
        const floats x = floats_at(at), y = floats_at(at + body.padded), z = floats_at(at + 2 * body.padded);
        c.x[k] = a.m[0] * x + a.m[1] * y + (a.m[2] * z + a.m[3]);
        c.y[k] = a.m[4] * x + a.m[5] * y + (a.m[6] * z + a.m[7]);
        c.z[k] = a.m[8] * x + a.m[9] * y + (a.m[10] * z + a.m[11]);
    }
    return c;
}

// Prepares sixteen faces for drawing; bit k is set where face k may cover a sample and is seen from its front.
static uint prepare(const Corners c, const floats shut, const int width, const int height, Faces *to)
{
    const floats left = least_of(least_of(c.x[0], c.x[1]), c.x[2]), right = most_of(most_of(c.x[0], c.x[1]), c.x[2]);
    const floats upper = least_of(least_of(c.y[0], c.y[1]), c.y[2]), lower = most_of(most_of(c.y[0], c.y[1]), c.y[2]);
    const ints top = first_from(upper, height), bottom = first_from(lower, height);
    const floats ax = c.x[1] - c.x[0], ay = c.y[1] - c.y[0], az = c.z[1] - c.z[0];
    const floats bx = c.x[2] - c.x[0], by = c.y[2] - c.y[0], bz = c.z[2] - c.z[0];
    const floats area = ax * by - ay * bx;
    const ints from = first_from(left, width), to_column = first_from(right, width);
    const ints seen = (from < to_column) & (top < bottom) & (fabs(area) > LEAST_AREA) & (shut * area <= 0.0f);
    const uint drawn = lanes_where(seen);
    if (drawn == 0) return 0;
    vstore16(from, 0, to->left);
    vstore16(to_column, 0, to->right);
    const floats row = convert_float16(top), per_area = 1.0f / area;
    for (int k = 0; k < 3; ++k) {
        const int next = k == 2 ? 0 : k + 1;
        const floats rise = c.y[next] - c.y[k];
        const ints sloping = fabs(rise) > LEAST_RISE, is_left = rise * area < 0.0f;
        const floats slope = (c.x[next] - c.x[k]) / rise, x = c.x[k] + (row - c.y[k]) * slope;
        vstore16(sloping ? (is_left ? (floats)1.0f : (floats)-1.0f) : 0.0f, 0, to->side[k]);
        vstore16(sloping ? (is_left ? -x : x - LEAST_RUN) : 1.0f, 0, to->from[k]);
        vstore16(sloping ? (is_left ? -slope : slope) : 0.0f, 0, to->step[k]);
    }
    const floats right_z = (az * by - ay * bz) * per_area, down_z = (ax * bz - az * bx) * per_area;
    vstore16(top, 0, to->top);
    vstore16(bottom, 0, to->bottom);
    vstore16(right_z, 0, to->right_z);
    vstore16(down_z, 0, to->down_z);
    vstore16(c.z[0] + (row - c.y[0]) * down_z - c.x[0] * right_z, 0, to->z);
    // Seen edge-on, a plane is steep: rounding must not carry its depth past the face's own corners.
    vstore16(least_of(least_of(c.z[0], c.z[1]), c.z[2]), 0, to->near);
    vstore16(most_of(most_of(c.z[0], c.z[1]), c.z[2]), 0, to->far);
    return drawn;
}

// Runs of samples [first, last) of face k in up to sixteen rows from `row` on.
static void find_runs(const Faces *faces, const int k, const int row, const int width, int *first, int *last)
{
    const floats rows = convert_float16(lane_numbers() + (row - faces->top[k]));
    floats left = -FAR_AWAY, right = FAR_AWAY;
    for (int e = 0; e < 3; ++e) {
        const float side = faces->side[e][k];
        const floats x = faces->from[e][k] + rows * faces->step[e][k];
        if (side > 0.0f) left = most_of(left, -x);
        if (side < 0.0f) right = least_of(right, x);
    }
    vstore16(first_from(left, width), 0, first);
    vstore16(first_from(right, width), 0, last);
}

// Depths are stored in sixteens that start at multiples of sixteen: what was stored last is loaded as it was stored.
#define KEEP_KEY(chosen) { \
    const ints key = convert_int16_rtz(deep) << bits | number, offered = (chosen) ? key : (ints)EMPTY; \
    const ints old = *(__global const ints *)at; \
    *(__global ints *)at = least_of(offered, old); }
#define KEEP_DEPTH(chosen) { \
    const floats offered = (chosen) ? deep : (floats)FAR_AWAY, old = *(__global const floats *)at; \
    *(__global floats *)at = least_of(offered, old); }

// Draws face k. A narrow one, as most are: sixteen columns after sixteen, all its rows, against all edges.
#define DRAW_FACE(NAME, TYPE, KEEP, ...) \
static void NAME(const Faces *faces, const int k, const int width, __global TYPE *picture, const int stride, __VA_ARGS__) \
{ \
    const int top = faces->top[k], bottom = faces->bottom[k], left = faces->left[k] & -LANES, right = faces->right[k]; \
    const float right_z = faces->right_z[k], down_z = faces->down_z[k]; \
    const floats near = faces->near[k], far = faces->far[k]; \
    const floats lanes = convert_float16(lane_numbers()); \
    if (right - left <= NARROW) { \
        for (int column = left; column < right; column += LANES) { \
            const floats x = lanes + (float)column; \
            const float a_step = faces->step[0][k], b_step = faces->step[1][k], c_step = faces->step[2][k]; \
            floats a = x * faces->side[0][k] + faces->from[0][k], b = x * faces->side[1][k] + faces->from[1][k]; \
            floats c = x * faces->side[2][k] + faces->from[2][k], z = x * right_z + faces->z[k]; \
            __global TYPE *at = picture + top * stride + column; \
            for (int row = top; row < bottom; ++row, at += stride) { \
                const floats deep = least_of(most_of(z, near), far); \
                KEEP((a >= 0.0f) & (b >= 0.0f) & (c >= 0.0f)) \
                a += a_step; \
                b += b_step; \
                c += c_step; \
                z += down_z; \
            } \
        } \
        return; \
    } \
    int first[LANES], last[LANES]; \
    for (int row = top; row < bottom; row += LANES) { \
        find_runs(faces, k, row, width, first, last); \
        for (int i = 0; i < min(LANES, bottom - row); ++i) { \
            const int begin = first[i], end = last[i]; \
            const floats z = lanes * right_z + (faces->z[k] + (float)(row + i - top) * down_z); \
            for (int column = begin & -LANES; column < end; column += LANES) { \
                __global TYPE *at = picture + (row + i) * stride + column; \
                const floats deep = least_of(most_of(z + (float)column * right_z, near), far); \
                const ints lane = lane_numbers() + column; \
                KEEP((lane >= begin) & (lane < end)) \
            } \
        } \
    } \
}

DRAW_FACE(draw_key, int, KEEP_KEY, const int number, const int bits)
DRAW_FACE(draw_depth, float, KEEP_DEPTH, const int unused)

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
            if (share) sum += share[sizes.n_groups + 1 + k] * lobe;
            else put(room.gloss + k * body.padded + first, lobe);
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

// One pose. With `share`, the weights of the planes: their sum into the first picture, and into a second, where there
// are two, the coverage. Without: every plane.
static void draw_pose(const Body body, const Sizes sizes, const Room room, __global const float *transforms,
    const float3 sun, __global const float *exponents, __global const float *share, const int pictures,
    __global float *out)
{
    const int pixels = sizes.side * sizes.side;
    clear(out, (share ? pictures : sizes.n_groups + 1 + sizes.n_gloss) * pixels);
    const Matrix same = {{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0}};
    const Range range = range_of(body, transforms, same, sizes.supersample);
    const float last = (float)sizes.fine;
    const int left = (int)clamp(range.low[0] - 1.0f, 0.0f, last) & -LANES;
    const int right = (int)clamp(range.high[0] + 2.0f, 0.0f, last);
    const int step = sizes.supersample, top = (int)clamp(range.low[1] - 1.0f, 0.0f, last) / step * step;
    const int bottom = min(((int)clamp(range.high[1] + 2.0f, 0.0f, last) + step - 1) / step * step, sizes.fine);
    if (left >= right || top >= bottom) return;
    int map_rows = 0;
    const Light light = light_of(body, sizes, transforms, sun, &map_rows);
    for (int row = top; row < bottom; ++row)
        for (int column = left; column < right; column += LANES)
            put_ints(room.keys + row * sizes.stride + column, EMPTY);
    const float deep = range.high[2] - range.low[2];
    const float steps = deep > 0.0f ? (float)((1 << (31 - body.bits)) - 2) / deep : 0.0f;
    Faces faces;
    for (int part = 0; part < body.parts; ++part) {
        const Matrix placed = part_matrix(transforms + 12 * part, sizes.supersample);
        const float hand = handedness(placed);
        for (int first = LANES * body.start[part]; first < LANES * body.start[part + 1]; first += LANES) {
            Corners c = corners_at(body, first, placed);
            const Corners kept = c;
            for (int k = 0; k < 3; ++k)
                c.z[k] = clamp((c.z[k] - range.low[2]) * steps, 0.0f, (float)((1 << (31 - body.bits)) - 2));
            uint drawn = prepare(c, hand * floats_at(body.shut + first), sizes.fine, sizes.fine, &faces);
            if (drawn == 0) continue;
            light_faces(body, sizes, room, light, kept, first, exponents, share);
            for (; drawn; drawn &= drawn - 1) {
                const int k = 31 - clz(drawn & -drawn);
                draw_key(&faces, k, sizes.fine, room.keys, sizes.stride, first + k, body.bits);
            }
        }
    }
    if (light.shadows) draw_from_sun(body, sizes, room, light, transforms, map_rows);
    const float each = 1.0f / (float)(step * step), per_step = steps > 0.0f ? 1.0f / steps : 0.0f;
    const float even = share ? share[sizes.n_groups] : 0.0f;
    __global float *sums = room.row, *covered = room.row + sizes.stride;
    for (int top_row = top; top_row < bottom; top_row += step) {
        const int i = top_row / step;
        clear(sums, sizes.stride);
        clear(covered, sizes.stride);
        bool some = false;
        for (int row = top_row; row < top_row + step; ++row)
            for (int column = left; column < right; column += LANES) {
                const ints key = ints_at(room.keys + row * sizes.stride + column), hit = key != EMPTY;
                if (!any_of(hit)) continue;
                some = true;
                const ints face = hit ? key & ((1 << body.bits) - 1) : 0;
                const floats full = hit ? gather(room.light, face) : 0.0f;
                const floats depth = range.low[2] + (convert_float16(key >> body.bits) + 0.5f) * per_step;
                floats lit = 1.0f;
                if (light.shadows && (any_of(full != 0.0f) || sizes.n_gloss > 0))
                    lit = reached(sizes, room, light.sun, row, column, depth, face);
                put(covered + column, floats_at(covered + column) + (hit ? (floats)1.0f : 0.0f));
                if (share) {
                    put(sums + column, floats_at(sums + column) + (hit ? full * lit + even : 0.0f));
                    continue;
                }
                int number[LANES];
                float shown[LANES], reach[LANES];
                vstore16(hit ? face : -1, 0, number);
                vstore16(full * lit * each, 0, shown);
                vstore16(lit * each, 0, reach);
                for (int k = 0; k < LANES; ++k) {
                    if (number[k] < 0) continue;
                    __global float *pixel = out + i * sizes.side + (column + k) / step;
                    pixel[body.group[number[k]] * pixels] += shown[k];
                    for (int g = 0; g < sizes.n_gloss; ++g)
                        pixel[(sizes.n_groups + 1 + g) * pixels]
                            += reach[k] * room.gloss[g * body.padded + number[k]];
                }
            }
        if (!some) continue;
        if (share) give_row(sizes, sums, out + i * sizes.side, each);
        const int second = share ? 1 : sizes.n_groups;
        if (!share || pictures > 1) give_row(sizes, covered, out + second * pixels + i * sizes.side, each);
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

// out (N, groups + 1 + gloss, side, side)
__kernel void planes(
    __global const float *transforms, __global const float *suns, const int poses, BODY_GIVEN, SIZES_GIVEN,
    __global const float *exponents, __global float *out, __global float *memory, const int each,
    volatile __global int *next)
{
    const Body body = BODY;
    const Sizes sizes = SIZES;
    const Room room = room_in(memory + get_global_id(0) * (size_t)each, body, sizes);
    const size_t size = (size_t)(n_groups + 1 + n_gloss) * side * side;
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
