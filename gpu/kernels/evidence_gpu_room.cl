// The light of N drawn poses against one patch of a frame, for devices that run thousands of items at once. What is
// reckoned is what evidence.cl reckons, which is made for a few strong cores and says why; the slow twin is
// service/inference/model/likelihood.py.
//
// The host launches one kernel after the other: cover, blur, start; each round light, slopes, speckle, model, stars,
// products, move; move once more for the curvature alone, finish, tell. What one launch has written the next reads, so
// that a pose may be shared out over as many groups as it has pixels, and few barriers are left. Dimension 1 of a
// launch counts poses. Built with GROUP, the items of a group, and STRIPS, in how many parts products are summed.

#define TOGETHER barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
#define ITEM ((int)get_local_id(0))
#define FOR_OWN(k, count) for (int k = ITEM; k < (count); k += GROUP)
#define GROUPS __attribute__((reqd_work_group_size(GROUP, 1, 1)))

// What every kernel takes; `begin` is the first pose of this launch. sizes: see scene_of; spreads (N, 4) and own (N, 4)
// as evidence.cl has them.
#define ASKED __global const int *sizes, __global const float *scalars, __global const int *spreads, \
    __global const float *own, __global float *memory, const int begin
#define SCENE const Scene s = scene_of(sizes, scalars, spreads, own, begin + (int)get_global_id(1)); \
    const Room r = room_in(memory + get_global_id(1) * (size_t)sizes[8], s);

typedef struct { int top, bottom, left, right; } Box;

typedef struct {
    int pose, groups, side, pixels, planes, positives, unknowns, speckle, shifts, first, stars, every, started;
    int component, components, tap, drawn;
    float sigma2, area, edge2, gain, star, wrong, width, photon, hidden;
} Scene;

// What a pose has of its own.
typedef struct {
    // (unknowns); last: the move before; tie: see evidence_facets.cl
    __global double *value, *mean, *precision, *pull, *last, *logs, *tie;
    __global double *paces;    // (2) of the last step, and what it promised
    __global float *scale;     // (unknowns)
    __global float *gained;    // (stars) nats
    __global float *partial;   // (STRIPS, blocks, 16) of the products
    __global int *plane;       // (positives) which plane each lit one is
    __global int *shows, *kin; // (positives) whether one is lit; of a lit one the first lit one of its piece
    __global int *told;        // see below
    __global float *pictures;  // (slots, pixels) from RESIDUAL on, positives whether they are lit or not
    __global float *light, *across, *down, *model, *root, *variance;  // pictures; root: of weights
    __global float *between;   // (planes, pixels)
} Room;

// Of `told`: what the body covers, the box beyond which it changes nothing, lit positives, whether steps go on; of the
// last matrix whether it was positive, and which two unknowns are held.
#define COVER 0
#define BODY 4
#define LIT 8
#define GOING 9
#define SOUND 10
#define FIRMLY 11
#define TOLD 16

static Scene scene_of(__global const int *sizes, __global const float *scalars, __global const int *spreads,
    __global const float *own, const int pose)
{
    Scene s;
    s.pose = pose;
    s.groups = sizes[0];
    s.side = sizes[1];
    s.planes = sizes[2];
    s.speckle = sizes[3];
    s.shifts = sizes[4];
    s.stars = sizes[5];
    s.every = sizes[6];
    s.started = sizes[7];
    s.pixels = s.side * s.side;
    s.positives = s.planes - EVEN_PLANES;
    const int more = (s.speckle ? HERMITE : 0) + (s.shifts ? 2 * BUMPS : 0);
    s.unknowns = s.positives + 9 + more;
    s.first = SPECKLE + more;
    s.component = spreads[4 * pose];
    s.components = spreads[4 * pose + 1];
    s.tap = spreads[4 * pose + 2];
    s.drawn = spreads[4 * pose + 3];
    s.sigma2 = scalars[0];
    s.area = scalars[1];
    s.edge2 = scalars[2];
    s.gain = scalars[3];
    s.star = scalars[4];
    s.wrong = own[4 * pose];
    s.width = own[4 * pose + 1];
    s.photon = own[4 * pose + 2];
    s.hidden = own[4 * pose + 3];
    return s;
}

static __global float *take(__global float **memory, const int count)
{
    __global float *taken = *memory;
    *memory += (count + 31) & -32;
    return taken;
}

// Blocks of four times four products of every two pictures.
static int blocks_of(const int slots)
{
    const int fours = (slots + 3) / 4;
    return fours * (fours + 1) / 2;
}

// In the order in which EvidenceGroups counts it.
static Room room_in(__global float *memory, const Scene s)
{
    const int slots = s.unknowns - 1;
    Room r;
    r.value = (__global double *)take(&memory, 2 * s.unknowns);
    r.mean = (__global double *)take(&memory, 2 * s.unknowns);
    r.precision = (__global double *)take(&memory, 2 * s.unknowns);
    r.pull = (__global double *)take(&memory, 2 * s.unknowns);
    r.last = (__global double *)take(&memory, 2 * s.unknowns);
    r.logs = (__global double *)take(&memory, 2 * s.unknowns);
    r.tie = (__global double *)take(&memory, 2 * s.unknowns);
    r.paces = (__global double *)take(&memory, 4);
    r.scale = take(&memory, s.unknowns);
    r.gained = take(&memory, s.stars);
    r.partial = take(&memory, STRIPS * 16 * blocks_of(slots));
    r.plane = (__global int *)take(&memory, s.positives);
    r.shows = (__global int *)take(&memory, s.positives);
    r.kin = (__global int *)take(&memory, s.positives);
    r.told = (__global int *)take(&memory, TOLD);
    r.pictures = take(&memory, (slots - RESIDUAL) * s.pixels);
    r.light = take(&memory, s.pixels);
    r.across = take(&memory, s.pixels);
    r.down = take(&memory, s.pixels);
    r.model = take(&memory, s.pixels);
    r.root = take(&memory, s.pixels);
    r.variance = take(&memory, s.pixels);
    r.between = take(&memory, s.planes * s.pixels);
    return r;
}

// The picture of a slot from RESIDUAL on.
static __global float *picture_in(const Scene s, const Room r, const int slot)
{
    return r.pictures + (slot - RESIDUAL) * s.pixels;
}

// The picture of the m-th lit positive.
static __global float *positive_in(const Scene s, const Room r, const int m)
{
    return picture_in(s, r, s.first + r.plane[m]);
}

// The slot of unknown m of a pose of which `lit` positives are in use, which have slots one after the other; the gain
// (m == lit) has none.
static int slot_of(const Scene s, const int lit, const int m)
{
    if (m < lit) return s.first + m;
    if (m < lit + 3) return EVEN;
    if (m < lit + 6) return SKY + m - lit - 3;
    return m < lit + 9 ? TILT + m - lit - 6 : SPECKLE + m - lit - 9;
}

// The picture of a slot, as `slot_of` counts them.
static __global const float *seen_in(const Scene s, const Room r, __global const float *sky, const int slot)
{
    if (slot < RESIDUAL) return sky + slot * s.pixels;
    return slot < s.first ? picture_in(s, r, slot) : positive_in(s, r, slot - s.first);
}

static Box box_at(const Room r, const int at)
{
    const Box box = {r.told[at], r.told[at + 1], r.told[at + 2], r.told[at + 3]};
    return box;
}

static int wide_of(const Box box) { return max(box.right - box.left, 0); }
static int area_of(const Box box) { return max(box.bottom - box.top, 0) * wide_of(box); }
static int pixel_of(const Box box, const int side, const int own)
{
    return (box.top + own / wide_of(box)) * side + box.left + own % wide_of(box);
}

static bool within(const Box box, const int row, const int column)
{
    return row >= box.top && row < box.bottom && column >= box.left && column < box.right;
}

// `radius` pixels more on every side, as far as there are any.
static Box widened(const Box box, const int radius, const int side)
{
    const Box wide = {max(box.top - radius, 0), min(box.bottom + radius, side), max(box.left - radius, 0),
        min(box.right + radius, side)};
    return wide;
}

// The sums of what the items bring, to all of them.
static double8 sum_of_all(__local double8 *sums, const double8 own)
{
    sums[ITEM] = own;
    for (int left = GROUP / 2; left > 0; left /= 2) {
        TOGETHER
        if (ITEM < left) sums[ITEM] += sums[ITEM + left];
    }
    TOGETHER
    return sums[0];
}
