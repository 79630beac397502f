// Resampling by cumulative weights (Eq. 6).
//
// Weights are whole numbers of 2^-k of the heaviest one's, k chosen on the host so that the sum of all fits into 62
// bits. Their sums are exact in any order: they never fall, and a particle of weight zero adds nothing and so is never
// drawn. Drawing r below the last sum does what dividing all sums by it would.
//
// Built with (gpu/step.py): GROUP, a power of two.

#define TILE (2 * GROUP)

// Replace v[0 .. TILE) by the sums of what is before each, and return the sum of all (Blelloch's work-efficient scan,
// 1990).
static ulong sums_before(__local ulong *v)
{
    const int me = get_local_id(0);
    int stride = 1;
    for (int pairs = GROUP; pairs > 0; pairs /= 2) {      // up: every node of the tree becomes the sum of its leaves
        barrier(CLK_LOCAL_MEM_FENCE);
        if (me < pairs) v[stride * (2 * me + 2) - 1] += v[stride * (2 * me + 1) - 1];
        stride *= 2;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    const ulong total = v[TILE - 1];
    barrier(CLK_LOCAL_MEM_FENCE);
    if (me == 0) v[TILE - 1] = 0;
    for (int pairs = 1; pairs <= GROUP; pairs *= 2) {     // down: every node tells its children what is before them
        stride /= 2;
        barrier(CLK_LOCAL_MEM_FENCE);
        if (me < pairs) {
            const int left = stride * (2 * me + 1) - 1, right = stride * (2 * me + 2) - 1;
            const ulong before = v[right];
            v[right] += v[left];
            v[left] = before;
        }
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    return total;
}

// Sums of the weights within each tile, up to and with each particle; `heaviest` is the weight of a log weight of 0.
__kernel void sum_tiles(
    __global const float *log_weights, const int n, const float heaviest,
    __global ulong *cumulative, __global ulong *tile_sums)
{
    __local ulong v[TILE];
    ulong weight[2];
    const int me = get_local_id(0), first = get_group_id(0) * TILE;
    for (int half_tile = 0; half_tile < 2; ++half_tile) {
        const int at = me + half_tile * GROUP, i = first + at;
        weight[half_tile] = i < n ? convert_ulong(heaviest * exp(log_weights[i])) : 0;
        v[at] = weight[half_tile];
    }
    const ulong total = sums_before(v);
    for (int half_tile = 0; half_tile < 2; ++half_tile) {
        const int at = me + half_tile * GROUP, i = first + at;
        if (i < n) cumulative[i] = v[at] + weight[half_tile];
    }
    if (me == 0) tile_sums[get_group_id(0)] = total;
}

// The tiles' sums -> the sum of all tiles before each. One work-group.
__kernel void sum_sums(__global ulong *tile_sums, const int tiles)
{
    __local ulong v[TILE];
    const int me = get_local_id(0);
    ulong before = 0;
    for (int first = 0; first < tiles; first += TILE) {
        for (int at = me; at < TILE; at += GROUP) v[at] = first + at < tiles ? tile_sums[first + at] : 0;
        const ulong total = sums_before(v);
        for (int at = me; at < TILE; at += GROUP)
            if (first + at < tiles) tile_sums[first + at] = before + v[at];
        before += total;
        barrier(CLK_LOCAL_MEM_FENCE);
    }
}

__kernel void add_sums(__global ulong *cumulative, const int n, __global const ulong *tile_sums)
{
    const int i = get_global_id(0);
    if (i < n) cumulative[i] += tile_sums[i / TILE];
}

// A whole number in [0, end), uniform.
static ulong uniform_below(const ulong end, const uint4 bits) { return mul_hi(upsample(bits.x, bits.y), end); }

// The i-th of n points with one random offset for all, evenly spaced over [0, total): (r + i) / n of it.
static ulong comb_point(const ulong total, const int i, const int n, const uint4 bits)
{
    const ulong spacing = total / n, rest = total % n;
    return i * spacing + i * rest / n + uniform_below(spacing, bits);
}

// The first particle whose cumulative weight is above the point.
static int first_above(__global const ulong *cumulative, const int n, const ulong point)
{
    int low = 0, high = n - 1;
    while (low < high) {
        const int middle = low + (high - low) / 2;
        if (cumulative[middle] > point)
            high = middle;
        else
            low = middle + 1;
    }
    return low;
}

// A fresh r per particle: Eq. 6 as written.
__kernel void multinomial(
    __global const ulong *cumulative, const int n, const ulong seed, const uint frame, __global int *ancestors)
{
    const int i = get_global_id(0);
    if (i >= n) return;
    const ulong r = uniform_below(cumulative[n - 1], draw(seed, frame, FOR_RESAMPLING, i, 0));
    ancestors[i] = first_above(cumulative, n, r);
}

// One r for all (Kitagawa 1996).
__kernel void systematic(
    __global const ulong *cumulative, const int n, const ulong seed, const uint frame, __global int *ancestors)
{
    const int i = get_global_id(0);
    if (i >= n) return;
    const ulong r = comb_point(cumulative[n - 1], i, n, draw(seed, frame, FOR_RESAMPLING, 0, 0));
    ancestors[i] = first_above(cumulative, n, r);
}
