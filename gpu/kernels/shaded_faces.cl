// Faces into a picture of depths or of keys, sixteen side by side; a part of shaded.cl.
//
// Faces come as corners, those of a part together, so that nothing is looked up by index: a corner is moved as often as
// faces share it, which is cheaper than to gather it. Coordinates count samples, and sample (i, j) is the point (j, i).

#pragma OPENCL FP_CONTRACT ON

#define EMPTY 0x7fffffff
#define FAR_AWAY 1e30f
#define LEAST_AREA 1e-6f     // a face smaller than this, in samples, is seen edge-on
#define LEAST_RISE 1e-6f     // an edge lower than this is level
#define LEAST_RUN 1e-5f      // before an edge on the right, its side is its neighbour's
#define NARROW 32            // samples up to which a face's rows are tested whole

#define DEEPEST(body) ((1 << (31 - (body).bits)) - 2)   // the largest depth in a key

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

typedef struct { float m[12]; } Matrix;   // (3, 4)

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
static void NAME( \
    const Faces *faces, const int k, const int width, __global TYPE *picture, const int stride, __VA_ARGS__) \
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
