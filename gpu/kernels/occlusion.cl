// Which pieces of a part are hidden behind another piece of it, for every direction of a cell?
//
// Coordinates of a cube face: a, b across and w along its major axis. Seen along (u, v, 1) a point lands at
// (a - u w, b - v w). Within a cell u and v stay within `half` of the centre, so two points at depths w and w' move
// against each other by at most half |w - w'| in a and in b. If no edge of piece M that may be outline in this cell
// comes that close to the box around piece K, then as many faces of M cover all of K as cover its centre from the
// cell's centre, in every direction of the cell. If that is at least one, K need not be drawn.

typedef struct { float2 at; float depth; } Seen;   // a point as the cell's centre sees it

static Seen look(__global const float *p, int axis, float u, float v)
{
    const float a = p[(axis + 1) % 3], b = p[(axis + 2) % 3], w = p[axis];
    Seen s = {(float2)(a - u * w, b - v * w), w};
    return s;
}

typedef struct { Seen centre; Seen arm[3]; float depth_reach; } Box;

static float reach(const Box *box, float2 n)
{
    return fabs(dot(n, box->arm[0].at)) + fabs(dot(n, box->arm[1].at)) + fabs(dot(n, box->arm[2].at));
}

// Do box and segment stay apart along direction n, whatever the direction within the cell?
static bool apart_along(float2 n, const Box *box, float2 middle, float2 half_segment, float shift)
{
    const float distance = fabs(dot(n, middle - box->centre.at));
    return distance > fabs(dot(n, half_segment)) + reach(box, n) + shift * (fabs(n.x) + fabs(n.y));
}

static float2 normal_to(float2 v) { return (float2)(-v.y, v.x); }

static bool apart(const Box *box, Seen p, Seen q, float half_cell, float slack)
{
    const float2 middle = 0.5f * (p.at + q.at), half_segment = 0.5f * (q.at - p.at);
    const float far = fmax(fabs(p.depth - box->centre.depth), fabs(q.depth - box->centre.depth)) + box->depth_reach;
    const float shift = half_cell * far + slack;
    return apart_along((float2)(1.0f, 0.0f), box, middle, half_segment, shift)
        || apart_along((float2)(0.0f, 1.0f), box, middle, half_segment, shift)
        || apart_along(normal_to(half_segment), box, middle, half_segment, shift)
        || apart_along(normal_to(box->arm[0].at), box, middle, half_segment, shift)
        || apart_along(normal_to(box->arm[1].at), box, middle, half_segment, shift)
        || apart_along(normal_to(box->arm[2].at), box, middle, half_segment, shift);
}

static bool covers(Seen a, Seen b, Seen c, float2 point)
{
    const float2 p = a.at - point, q = b.at - point, r = c.at - point;
    const float x = p.x * q.y - p.y * q.x, y = q.x * r.y - q.y * r.x, z = r.x * p.y - r.y * p.x;
    return (x > 0.0f && y > 0.0f && z > 0.0f) || (x < 0.0f && y < 0.0f && z < 0.0f);
}

// One work-item per cell and piece. `ends` has 6 floats per edge, `corners` 9 per face, `boxes` 12 per piece.
__kernel void find_hidden(
    const int across, const int pieces, __global const float *boxes,
    __global const int *edge_start, __global const float *ends, __global const uchar *possible,
    __global const int *face_start, __global const float *corners, const float slack, __global uchar *hidden)
{
    const int cell = get_global_id(0), piece = get_global_id(1), n_edges = edge_start[pieces];
    const int axis = cell / (across * across), row = cell / across % across, column = cell % across;
    const float half_cell = 1.0f / across;
    const float u = -1.0f + (2 * column + 1) * half_cell, v = -1.0f + (2 * row + 1) * half_cell;
    Box box;
    box.centre = look(boxes + piece * 12, axis, u, v);
    box.depth_reach = 0.0f;
    for (int i = 0; i < 3; ++i) {
        box.arm[i] = look(boxes + piece * 12 + 3 + i * 3, axis, u, v);
        box.depth_reach += fabs(box.arm[i].depth);
    }
    bool found = false;
    for (int other = 0; other < pieces && !found; ++other) {
        if (other == piece) continue;
        Box cover;
        cover.centre = look(boxes + other * 12, axis, u, v);
        for (int i = 0; i < 3; ++i) cover.arm[i] = look(boxes + other * 12 + 3 + i * 3, axis, u, v);
        const float2 offset = fabs(cover.centre.at - box.centre.at);
        const float2 x = (float2)(1.0f, 0.0f), y = (float2)(0.0f, 1.0f);
        if (offset.x + reach(&box, x) > reach(&cover, x) || offset.y + reach(&box, y) > reach(&cover, y)) continue;
        for (int f = face_start[other]; f < face_start[other + 1] && !found; ++f) {
            __global const float *p = corners + f * 9;
            found = covers(look(p, axis, u, v), look(p + 3, axis, u, v), look(p + 6, axis, u, v), box.centre.at);
        }
        for (int e = edge_start[other]; e < edge_start[other + 1] && found; ++e)
            if (possible[(size_t)cell * n_edges + e])
                found = apart(
                    &box, look(ends + e * 6, axis, u, v), look(ends + e * 6 + 3, axis, u, v), half_cell, slack);
    }
    hidden[(size_t)cell * pieces + piece] = found;
}
