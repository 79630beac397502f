// The light on a body's faces, and the shadows that it casts on itself; a part of shaded.cl.
//
// Built with BIAS, the texels by which a face may lie deeper than the Sun's view says and be lit, and STEEPEST, beyond
// which a face is taken to be no steeper there; and NEAREST, the share of the distance to the body's centre within
// which nothing is drawn as if it were nearer; and EVEN_PLANES: coverage, and the mean normal's three parts.

#define BORDER 1.0f          // texels around the body in the Sun's view
#define DIMMEST -23.0f       // log2 of a lobe of gloss below which it is dark: tiny numbers are slow to reckon with

typedef struct {
    int side, fine, stride;         // pixels, samples along one, and in memory
    int supersample, shadow, shadow_side, shadow_stride;
    int n_groups, n_shiny, n_gloss; // groups of paint, groups of gloss, lobes that each of these has
    float lens, middle_x, middle_y; // of a pinhole camera: one over its focal length, its principal point (samples)
    float4 around;                  // light from all around on a face of normal n: around.xyz . n + around.w, or none
} Sizes;

// A face's number of its group of paint and that of its group of gloss are in one.
#define PAINT_OF(group) ((group) & 0xffff)
#define SHINE_OF(group) ((group) >> 16)

// The plane of a group's lobe.
#define LOBE(sizes, k, shine) ((sizes).n_groups + EVEN_PLANES + (k) * (sizes).n_shiny + (shine))

typedef struct {
    __global int *keys;             // (fine, stride)
    __global float *map;            // (shadow_side, shadow_stride) depths from the Sun
    __global float *light;          // (padded): what a face shows where the Sun reaches it
    __global float *even;           // (3, padded) normals; with weights of planes (padded) light from everywhere
    __global float *aside, *down;   // (padded): slopes of a face in the Sun's view
    __global float *gloss;          // (n_gloss, padded)
    __global float *row;            // (1 + EVEN_PLANES, stride): sums of samples
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

// What a camera sees of corners whose depth is counted from the body's centre, at its scale: planes stay planes.
static Corners through_lens(Corners c, const Sizes sizes)
{
    if (sizes.lens == 0.0f) return c;
    for (int k = 0; k < 3; ++k) {
        const floats nearer = 1.0f / most_of(1.0f + sizes.lens * c.z[k], (floats)NEAREST);
        c.x[k] = sizes.middle_x + (c.x[k] - sizes.middle_x) * nearer;
        c.y[k] = sizes.middle_y + (c.y[k] - sizes.middle_y) * nearer;
        c.z[k] *= nearer;
    }
    return c;
}

// What a camera sees of a range.
static Range seen_range(Range range, const Sizes sizes)
{
    if (sizes.lens == 0.0f) return range;
    const float middle[2] = {sizes.middle_x, sizes.middle_y};
    const float front = 1.0f / max(1.0f + sizes.lens * range.low[2], NEAREST);
    const float back = 1.0f / max(1.0f + sizes.lens * range.high[2], NEAREST);
    for (int i = 0; i < 2; ++i) {
        const float low = range.low[i] - middle[i], high = range.high[i] - middle[i];
        range.low[i] = middle[i] + low * (low < 0.0f ? front : back);
        range.high[i] = middle[i] + high * (high < 0.0f ? back : front);
    }
    range.low[2] *= front;
    range.high[2] *= back;
    return range;
}

// Unit normals of sixteen faces, on the side that is seen.
static void normals_of(const Corners c, const Sizes sizes, floats *n)
{
    const floats ax = c.x[1] - c.x[0], ay = c.y[1] - c.y[0], az = c.z[1] - c.z[0];
    const floats bx = c.x[2] - c.x[0], by = c.y[2] - c.y[0], bz = c.z[2] - c.z[0];
    n[0] = ay * bz - az * by;
    n[1] = az * bx - ax * bz;
    n[2] = ax * by - ay * bx;
    const floats square = n[0] * n[0] + n[1] * n[1] + n[2] * n[2];
    const floats length = sqrt(most_of(square, (floats)1e-30f));
    const floats right = sizes.lens * (c.x[0] - sizes.middle_x), low = sizes.lens * (c.y[0] - sizes.middle_y);
    const floats away = n[0] * right + n[1] * low + n[2] * (1.0f + sizes.lens * c.z[0]);
    const floats per_length = (away > 0.0f ? (floats)-1.0f : (floats)1.0f) / length;
    for (int k = 0; k < 3; ++k) n[k] *= per_length;
}

// Light from all around on sixteen faces of these normals.
static floats from_around(const Sizes sizes, const floats x, const floats y, const floats z)
{
    return most_of(sizes.around.x * x + sizes.around.y * y + sizes.around.z * z + sizes.around.w, (floats)0.0f);
}

// What sixteen faces show in full light, and how they lie in the Sun's view. `share` NULL: planes are asked for.
static void light_faces(const Body body, const Sizes sizes, const Room room, const Light light, const Corners c,
    const int first, __global const float *exponents, __global const float *share)
{
    floats n[3];
    normals_of(c, sizes, n);
    const floats cosine = n[0] * light.towards.x + n[1] * light.towards.y + n[2] * light.towards.z;
    const ints facing = cosine > 0.0f;
    floats sum = facing ? cosine : 0.0f;
    const ints group = ints_at(body.group + first);
    if (share) {
        __global const float *even = share + sizes.n_groups;
        const floats own = gather(share, PAINT_OF(group));
        sum *= own;
        put(room.even + first, even[0] + even[1] * n[0] + even[2] * n[1] + even[3] * n[2]
            + own * from_around(sizes, n[0], n[1], n[2]));
    } else for (int k = 0; k < 3; ++k) put(room.even + k * body.padded + first, n[k]);
    if (sizes.n_gloss > 0) {
        const floats towards = n[0] * light.half_way.x + n[1] * light.half_way.y + n[2] * light.half_way.z;
        const floats shine = towards > 0.0f ? towards : 0.0f;
        for (int k = 0; k < sizes.n_gloss; ++k) {
            const floats power = exponents[k] * log2(shine);
            const floats lobe = facing & (power > DIMMEST) ? exp2(power) : 0.0f;
            if (share) sum += gather(share + LOBE(sizes, k, 0), SHINE_OF(group)) * lobe;
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
    floats depth, const ints face)
{
    floats x = convert_float16(lane_numbers() + column), y = (float)row;
    if (sizes.lens != 0.0f) {
        const floats farther = 1.0f / (1.0f - sizes.lens * depth);
        x = sizes.middle_x + (x - sizes.middle_x) * farther;
        y = sizes.middle_y + (y - sizes.middle_y) * farther;
        depth *= farther;
    }
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
