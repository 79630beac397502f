// Faces into a tile of samples in local memory, drawn by a whole work-group; a part of shaded_gpu.cl.
//
// Built with GROUP, the items of a group, and TILE, the samples of a tile. A round takes at most one face an item:
// each looks among its own for the next one that is seen in the tile. Then the rows of all of them, in pieces of RUN
// samples, are shared out over the items, so that no item draws a large face alone. Local atomics keep the nearest.

#define RUN 32               // samples of a row that an item draws at most
#define PIECE_BITS 22        // of a round's pieces, and above them its faces, in one number
#define TALLEST 1024         // rows of a tile: a round's pieces stay below 2^22

typedef struct { int top, bottom, left, right; } Tile;

// The samples that the body may cover, and how many steps of depth a sample is long in keys.
typedef struct { Tile tile; float near, steps; } Window;

typedef struct { float x[3], y[3], z[3]; } Corner;   // one face's three

// Of the faces of a round (GROUP each): in a row r rows below a face's first, its samples lie between edges at
// from + r step, and at the c-th column of its box in that row the depth is z + c right_z + r down_z.
typedef struct {
    __local float *numbers;          // (11, GROUP): from (3), step (3), z, right_z, down_z, near, far
    __local int *begin;              // its first piece
    __local int *place;              // row and column of its box in the tile
    __local int *shape;              // columns of the box, and which edges are on the left
    __local int *number;
    volatile __local uint *filled;   // faces and pieces so far
    volatile __local int *samples;   // (TILE) keys, or depths in the order of their bits
} Round;

// What a pose's faces are drawn with.
typedef struct {
    __global const float *transforms;
    Light light;
    Window window;                   // of the camera
} Pose;

#define NUMBER(name, slot) round.numbers[(name) * GROUP + (slot)]
#define FROM 0
#define STEP 3
#define DEPTH 6
#define RIGHT_Z 7
#define DOWN_Z 8
#define NEAR_Z 9
#define FAR_Z 10

// The first of the points 0, 1, 2, ... that is not before v, within [begin, end].
static int first_in(const float v, const int begin, const int end)
{
    float held = v > (float)begin ? v : (float)begin;
    held = held < (float)end ? held : (float)end;
    const int whole = (int)held;
    return whole + (held > (float)whole);
}

static Corner corner_at(const Body body, const int face, const Matrix a)
{
    Corner c;
    for (int k = 0; k < 3; ++k) {
        __global const float *at = body.corners + 3 * k * body.padded + face;
        const float x = at[0], y = at[body.padded], z = at[2 * body.padded];
        c.x[k] = a.m[0] * x + a.m[1] * y + (a.m[2] * z + a.m[3]);
        c.y[k] = a.m[4] * x + a.m[5] * y + (a.m[6] * z + a.m[7]);
        c.z[k] = a.m[8] * x + a.m[9] * y + (a.m[10] * z + a.m[11]);
    }
    return c;
}

// See through_lens.
static Corner seen_corner(Corner c, const Sizes sizes)
{
    if (sizes.lens == 0.0f) return c;
    for (int k = 0; k < 3; ++k) {
        const float nearer = 1.0f / most_of(1.0f + sizes.lens * c.z[k], NEAREST);
        c.x[k] = sizes.middle_x + (c.x[k] - sizes.middle_x) * nearer;
        c.y[k] = sizes.middle_y + (c.y[k] - sizes.middle_y) * nearer;
        c.z[k] *= nearer;
    }
    return c;
}

// Puts a face into the round, where it may cover a sample of the tile and is seen from its front: see prepare.
static bool take_face(const Corner c, const float shut, const Tile tile, const int number, const Round round)
{
    const float first_y = least_of(least_of(c.y[0], c.y[1]), c.y[2]);
    const float last_y = most_of(most_of(c.y[0], c.y[1]), c.y[2]);
    const int top = first_in(first_y, tile.top, tile.bottom), bottom = first_in(last_y, tile.top, tile.bottom);
    if (top >= bottom) return false;
    const float first_x = least_of(least_of(c.x[0], c.x[1]), c.x[2]);
    const float last_x = most_of(most_of(c.x[0], c.x[1]), c.x[2]);
    const int left = first_in(first_x, tile.left, tile.right), right = first_in(last_x, tile.left, tile.right);
    const float ax = c.x[1] - c.x[0], ay = c.y[1] - c.y[0], az = c.z[1] - c.z[0];
    const float bx = c.x[2] - c.x[0], by = c.y[2] - c.y[0], bz = c.z[2] - c.z[0];
    const float area = ax * by - ay * bx;
    if (left >= right || !(fabs(area) > LEAST_AREA) || !(shut * area <= 0.0f)) return false;
    const uint pieces = (bottom - top) * ((right - left + RUN - 1) / RUN);
    const uint before = atomic_add(round.filled, 1u << PIECE_BITS | pieces);
    const int slot = before >> PIECE_BITS;
    round.begin[slot] = before & ((1u << PIECE_BITS) - 1);
    round.place[slot] = (top - tile.top) << 16 | (left - tile.left);
    round.number[slot] = number;
    int on_left = 0;
    for (int k = 0; k < 3; ++k) {
        const int next = k == 2 ? 0 : k + 1;
        const float rise = c.y[next] - c.y[k], slope = (c.x[next] - c.x[k]) / rise;
        const bool sloping = fabs(rise) > LEAST_RISE, is_left = rise * area < 0.0f || !sloping;
        const float x = c.x[k] + ((float)top - c.y[k]) * slope - (is_left ? 0.0f : LEAST_RUN);
        on_left |= is_left << k;
        NUMBER(FROM + k, slot) = sloping ? x : -FAR_AWAY;   // a level edge bounds nothing
        NUMBER(STEP + k, slot) = sloping ? slope : 0.0f;
    }
    round.shape[slot] = (right - left) << 3 | on_left;
    const float right_z = (az * by - ay * bz) / area, down_z = (ax * bz - az * bx) / area;
    NUMBER(DEPTH, slot) = c.z[0] + ((float)top - c.y[0]) * down_z + ((float)left - c.x[0]) * right_z;
    NUMBER(RIGHT_Z, slot) = right_z;
    NUMBER(DOWN_Z, slot) = down_z;
    // Seen edge-on, a plane is steep: rounding must not carry its depth past the face's own corners.
    NUMBER(NEAR_Z, slot) = least_of(least_of(c.z[0], c.z[1]), c.z[2]);
    NUMBER(FAR_Z, slot) = most_of(most_of(c.z[0], c.z[1]), c.z[2]);
    return true;
}

// Draws a piece of a row of one of the round's `faces` faces: its key, or with `bits` < 0 its depth.
static void draw_piece(const int piece, const int faces, const Tile tile, const int bits, const Round round)
{
    int slot = 0;
    for (int end = faces; end - slot > 1;) {
        const int middle = (slot + end) / 2;
        if (round.begin[middle] <= piece) slot = middle;
        else end = middle;
    }
    const int shape = round.shape[slot], columns = shape >> 3, along = (columns + RUN - 1) / RUN;
    const int place = round.place[slot], number = round.number[slot];
    int row = piece - round.begin[slot], column = 0;
    if (along > 1) {
        column = row % along * RUN;
        row /= along;
    }
    const int box = place & 0xffff;   // of the tile's columns
    int first = box + column, last = min(first + RUN, box + columns);
    float left = (float)(tile.left + first), right = (float)(tile.left + last);
    for (int k = 0; k < 3; ++k) {
        const float x = NUMBER(FROM + k, slot) + (float)row * NUMBER(STEP + k, slot);
        if (shape & 1 << k) left = most_of(x, left);
        else right = least_of(x, right);
    }
    first = first_in(left, tile.left + first, tile.left + last) - tile.left;
    last = first_in(right, tile.left + first, tile.left + last) - tile.left;
    const float near = NUMBER(NEAR_Z, slot), far = NUMBER(FAR_Z, slot), right_z = NUMBER(RIGHT_Z, slot);
    const float z = NUMBER(DEPTH, slot) + (float)row * NUMBER(DOWN_Z, slot);
    volatile __local int *samples = round.samples + ((place >> 16) + row) * (tile.right - tile.left);
    for (int j = first; j < last; ++j) {
        const float deep = least_of(most_of(z + (float)(j - box) * right_z, near), far);
        atomic_min(samples + j, bits < 0 ? as_int(deep) : (int)deep << bits | number);
    }
}

// Looks at a face as the Sun or the camera sees it, and puts it into the round where it is seen in the tile; of those
// that the camera sees, `records` notes what they show of the light, if there are any.
static bool look_at(const Body body, const Sizes sizes, const Pose pose, const Tile tile, const Matrix placed,
    const int face, const bool from_sun, const Round round, const Records records)
{
    const Matrix view = from_sun ? after(pose.light.sun, placed) : placed;
    const Corner c = corner_at(body, face, view);
    Corner deep = c;
    if (!from_sun) {
        deep = seen_corner(c, sizes);
        for (int k = 0; k < 3; ++k)
            deep.z[k] = clamp((deep.z[k] - pose.window.near) * pose.window.steps, 0.0f, (float)DEEPEST(body));
    }
    if (!take_face(deep, handedness(view) * body.shut[face], tile, face, round)) return false;
    if (!from_sun && records.faces) light_face(body, sizes, records, pose.light, c.x, c.y, c.z, face);
    return true;
}

// Draws all faces into a tile: depths as the Sun sees them, or keys. All of the group's items come here together, and
// leave when the tile is whole.
static void draw_tile(const Body body, const Sizes sizes, const Pose pose, const Tile tile, const bool from_sun,
    const Round round, const Records records)
{
    const int item = get_local_id(0), size = (tile.bottom - tile.top) * (tile.right - tile.left);
    for (int k = item; k < size; k += GROUP) round.samples[k] = from_sun ? as_int(FAR_AWAY) : EMPTY;
    const int end = LANES * body.start[body.parts];
    int face = LANES * body.start[0] + item, part = 0, faces;
    do {
        if (item == 0) *round.filled = 0;
        barrier(CLK_LOCAL_MEM_FENCE);
        for (bool taken = false; face < end && !taken; face += GROUP) {
            while (face >= LANES * body.start[part + 1]) ++part;
            const Matrix placed = part_matrix(pose.transforms + 12 * part, sizes.supersample);
            taken = look_at(body, sizes, pose, tile, placed, face, from_sun, round, records);
        }
        barrier(CLK_LOCAL_MEM_FENCE);
        const uint filled = *round.filled;
        faces = filled >> PIECE_BITS;
        for (int piece = item; piece < (int)(filled & ((1u << PIECE_BITS) - 1)); piece += GROUP)
            draw_piece(piece, faces, tile, from_sun ? -1 : body.bits, round);
        barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
    } while (faces > 0);
}
