// The light on single faces, and how much of the Sun reaches single samples; a part of shaded_gpu.cl.
//
// A face's record is eight numbers: the light that it shows where the Sun reaches it, its slopes in the Sun's view (2),
// its group, its normal (3; with weights of planes the light from everywhere instead), light from all around.

typedef struct {
    __global float4 *faces;             // (padded, 2)
    __global float *gloss;              // (n_gloss, padded)
    __global const float *exponents;    // (n_gloss)
    __global const float *share;        // weights of planes, or NULL: planes are asked for
} Records;

// Unit normal of a face, on the side that is seen: see normals_of.
static float3 normal_of(const Sizes sizes, const float *x, const float *y, const float *z)
{
    const float3 a = {x[1] - x[0], y[1] - y[0], z[1] - z[0]}, b = {x[2] - x[0], y[2] - y[0], z[2] - z[0]};
    const float3 n = {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
    const float square = n.x * n.x + n.y * n.y + n.z * n.z, length = sqrt(most_of(square, 1e-30f));
    const float right = sizes.lens * (x[0] - sizes.middle_x), low = sizes.lens * (y[0] - sizes.middle_y);
    const float away = n.x * right + n.y * low + n.z * (1.0f + sizes.lens * z[0]);
    return n * ((away > 0.0f ? -1.0f : 1.0f) / length);
}

// Notes what a face shows in full light, and how it lies in the Sun's view: see light_faces.
static void light_face(const Body body, const Sizes sizes, const Records to, const Light light, const float *x,
    const float *y, const float *z, const int face)
{
    const float3 n = normal_of(sizes, x, y, z);
    const float cosine = n.x * light.towards.x + n.y * light.towards.y + n.z * light.towards.z;
    const int group = body.group[face], paint = PAINT_OF(group);
    float shown = cosine > 0.0f ? cosine : 0.0f;
    float3 rest = n;
    const float around = most_of(dot(sizes.around.xyz, n) + sizes.around.w, 0.0f);
    if (to.share) {
        __global const float *even = to.share + sizes.n_groups;
        shown *= to.share[paint];
        rest.x = even[0] + even[1] * n.x + even[2] * n.y + even[3] * n.z + to.share[paint] * around;
    }
    const float towards = n.x * light.half_way.x + n.y * light.half_way.y + n.z * light.half_way.z;
    for (int k = 0; k < sizes.n_gloss; ++k) {
        const float power = to.exponents[k] * log2(towards > 0.0f ? towards : 0.0f);
        const float lobe = cosine > 0.0f && power > DIMMEST ? exp2(power) : 0.0f;
        if (to.share) shown += to.share[LOBE(sizes, k, SHINE_OF(group))] * lobe;
        else to.gloss[k * body.padded + face] = lobe;
    }
    float aside = 0.0f, down = 0.0f;
    if (light.shadows) {
        const float per_cosine = 1.0f / most_of(cosine, 1e-6f);
        const float3 u = normalize((float3)(light.sun.m[0], light.sun.m[1], light.sun.m[2]));
        const float3 v = normalize((float3)(light.sun.m[4], light.sun.m[5], light.sun.m[6]));
        aside = clamp((n.x * u.x + n.y * u.y + n.z * u.z) * per_cosine, -STEEPEST, STEEPEST);
        down = clamp((n.x * v.x + n.y * v.y + n.z * v.z) * per_cosine, -STEEPEST, STEEPEST);
    }
    to.faces[2 * face] = (float4)(shown, aside, down, as_float(group));
    to.faces[2 * face + 1] = (float4)(rest.x, rest.y, rest.z, around);
}

// The Sun's view of a body that lies in `range` along the Sun's axes; `map`: its columns and rows. See light_of.
static Light light_in(const Body body, const Sizes sizes, const Range range, const float scale, const float3 sun,
    int *columns, int *rows)
{
    Light light;
    light.towards = normalize(sun);
    const float3 camera = {0.0f, 0.0f, -1.0f}, both = light.towards + camera;
    light.half_way = dot(both, both) > 1e-12f ? normalize(both) : (float3)0.0f;
    light.shadows = sizes.shadow > 0;
    light.sun = sun_axes(light.towards);
    *columns = *rows = 0;
    if (!light.shadows) return light;
    const float wide = max(range.high[0] - range.low[0], range.high[1] - range.low[1]);
    const float zoom = sizes.shadow / max(max(wide, 2.0f * body.radius * scale), 1e-12f);
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) light.sun.m[4 * i + j] *= zoom;
        light.sun.m[4 * i + 3] = BORDER - zoom * range.low[i];
    }
    *columns = min((int)(zoom * (range.high[0] - range.low[0]) + 2.0f * BORDER) + 2, sizes.shadow_side);
    *rows = min((int)(zoom * (range.high[1] - range.low[1]) + 2.0f * BORDER) + 2, sizes.shadow_side);
    return light;
}

// How much of the Sun reaches the sample in (column, row) at a depth, of a face of these slopes: see reached.
static float reaching(const Sizes sizes, const Matrix sun, __global const float *map, const int columns,
    const int rows, float x, float y, float depth, const float aside, const float below)
{
    if (sizes.lens != 0.0f) {
        const float farther = 1.0f / (1.0f - sizes.lens * depth);
        x = sizes.middle_x + (x - sizes.middle_x) * farther;
        y = sizes.middle_y + (y - sizes.middle_y) * farther;
        depth *= farther;
    }
    float u = sun.m[0] * x + (sun.m[2] * depth + (sun.m[1] * y + sun.m[3]));
    float v = sun.m[4] * x + (sun.m[6] * depth + (sun.m[5] * y + sun.m[7]));
    const float w = sun.m[8] * x + (sun.m[10] * depth + (sun.m[9] * y + sun.m[11] - BIAS));
    u = u > 0.0f ? u : 0.0f;
    u = u < (float)(columns - 2) ? u : (float)(columns - 2);
    v = v > 0.0f ? v : 0.0f;
    v = v < (float)(rows - 2) ? v : (float)(rows - 2);
    const int i = (int)v, j = (int)u;
    const float right = u - (float)j, down = v - (float)i, here = w - right * aside - down * below, rest = 1.0f - right;
    __global const float *at = map + i * columns + j;
    const float upper = (here <= at[0] ? rest : 0.0f) + (here + aside <= at[1] ? right : 0.0f);
    const float lower = (here + below <= at[columns] ? rest : 0.0f)
        + (here + below + aside <= at[columns + 1] ? right : 0.0f);
    return upper + down * (lower - upper);
}
