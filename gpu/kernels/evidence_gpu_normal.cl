// Sums over pixels of the products of every two pictures, and the linear algebra on them, of evidence_gpu_room.cl.
//
// An item has four times four of the products in registers. A group brings tiles of pixels of all pictures to local
// memory. A tile is summed in float, then the tiles of a strip, then strips in double, as is all linear algebra. Built
// with MATRIX, the memory that matrices lie in: __local where they have room there.

#define PIXELS 32  // of a tile
#define ACROSS 16  // items that share a row of a matrix: GROUP is a multiple of it

typedef struct { int row, column; } Block;

// The k-th block of four times four below the diagonal or on it.
static Block block_at(const int k)
{
    Block b;
    b.row = (int)((sqrt(8.0f * (float)k + 1.0f) - 1.0f) * 0.5f);
    while (b.row * (b.row + 1) / 2 > k) --b.row;
    while ((b.row + 1) * (b.row + 2) / 2 <= k) ++b.row;
    b.column = k - b.row * (b.row + 1) / 2;
    return b;
}

// Four pictures at one pixel, each times the root of its weight. Beyond the body there is sky alone.
static float4 four_at(const Scene s, const Room r, __global const float *sky, const int four, const int slots,
    const bool inside, const int pixel)
{
    float seen[4];
    for (int k = 0; k < 4; ++k) {
        const int slot = 4 * four + k;
        seen[k] = slot < slots && (inside || slot < EVEN) ? seen_in(s, r, sky, slot)[pixel] : 0.0f;
    }
    return r.root[pixel] * vload4(0, seen);
}

// Sums of weight * picture i * picture j: of each pose a group takes GROUP blocks in a strip, which is every STRIPS-th
// tile, so that each strip has its share of the body. An odd number of fours lies between pixels of `tile`: they are in
// other banks.
__kernel GROUPS void products(ASKED, __global const float *sky, __local float4 *tile)
{
    SCENE
    const Box body = box_at(r, BODY);
    const int slots = s.first + r.told[LIT], fours = (slots + 3) / 4, apart = fours | 1;
    const int strip = (int)get_group_id(0) % STRIPS, first = (int)get_group_id(0) / STRIPS * GROUP;
    const int blocks = blocks_of(slots), number = first + ITEM;
    const Block b = block_at(min(number, blocks - 1));
    float4 p = 0.0f, q = 0.0f, u = 0.0f, v = 0.0f;
    const int end = r.told[GOING] && first < blocks ? s.pixels : 0;
    for (int at = strip * PIXELS; at < end; at += STRIPS * PIXELS) {
        const bool some = (at + PIXELS - 1) / s.side >= body.top && at / s.side < body.bottom;
        const int few = some ? fours : 1;  // the sky and the residual alone, which are the first four
        TOGETHER
        FOR_OWN(own, PIXELS * few) {
            const int pixel = own % PIXELS, k = at + pixel;
            tile[pixel * apart + own / PIXELS] = four_at(s, r, sky, own / PIXELS, slots,
                within(body, k / s.side, k % s.side), k);
        }
        TOGETHER
        if (number < blocks && b.row < few) {
            float4 a = 0.0f, c = 0.0f, d = 0.0f, e = 0.0f;
            for (int pixel = 0; pixel < PIXELS; ++pixel) {
                const float4 left = tile[pixel * apart + b.row], right = tile[pixel * apart + b.column];
                a = fma((float4)left.x, right, a);
                c = fma((float4)left.y, right, c);
                d = fma((float4)left.z, right, d);
                e = fma((float4)left.w, right, e);
            }
            p += a; q += c; u += d; v += e;
        }
    }
    if (end > 0 && number < blocks)
        vstore16((float16)(p, q, u, v), number, r.partial + strip * 16 * blocks_of(s.unknowns - 1));
}

// The sum over all pixels of weight * picture i * picture j.
static double total_of(const Scene s, const Room r, const int i, const int j)
{
    const int row = max(i, j), column = min(i, j), block = row / 4 * (row / 4 + 1) / 2 + column / 4;
    __global const float *at = r.partial + 16 * block + 4 * (row % 4) + column % 4;
    double sum = 0.0;
    for (int strip = 0; strip < STRIPS; ++strip) sum += (double)at[strip * 16 * blocks_of(s.unknowns - 1)];
    return sum;
}

// Where the upper half of a matrix of n rows has element (i, j), j >= i; column n is the right side.
static int cell(const int n, const int i, const int j) { return i * (n + 1) - i * (i + 1) / 2 + j; }
static int cell_of(const int n, const int i, const int j) { return cell(n, min(i, j), max(i, j)); }

// How a step is held: unknowns that would leave their range stay at its end.
typedef struct { bool firm[2]; double end[2]; } Ends;

// The upper half of J' W J + P, and beside it J' W r - P (value - mean), from the sums of products.
static void draw_normal(const Scene s, const Room r, const int lit, const int count, const Ends ends,
    MATRIX double *a)
{
    TOGETHER
    for (int i = ITEM / ACROSS; i < count; i += GROUP / ACROSS)
        for (int j = i + ITEM % ACROSS; j <= count; j += ACROSS) {
            const double scale = (double)r.scale[i] * (j < count ? (double)r.scale[j] : 1.0);
            a[cell(count, i, j)] = i == lit || j == lit ? 0.0
                : scale * total_of(s, r, slot_of(s, lit, i), j < count ? slot_of(s, lit, j) : RESIDUAL);
        }
    TOGETHER
    // The gain's picture is the sum of those of all positives and of the even light's share.
    FOR_OWN(j, count + 1) {
        double sum = 0.0;
        for (int m = 0; m < lit + 2; ++m)
            if (m != lit && j != lit) sum += (m < lit ? 1.0 : r.value[m]) * a[cell_of(count, m, j)];
        if (j != lit) a[cell_of(count, lit, j)] = sum;
    }
    TOGETHER
    FOR_OWN(i, count) {
        double curvature = i == lit ? r.value[lit + 1] * a[cell(count, lit, lit + 1)] : a[cell(count, i, i)];
        for (int m = 0; i == lit && m < lit; ++m) curvature += a[cell(count, m, lit)];
        curvature += r.precision[i];
        double pull = a[cell(count, i, count)] - r.precision[i] * (r.value[i] - r.mean[i]);
        for (int j = i < lit ? r.kin[i] : count; r.tie[i] > 0.0 && j < lit && r.kin[j] == r.kin[i]; ++j) {
            pull += r.tie[i] * (r.value[j] - r.mean[j]);
            if (j == i) curvature -= r.tie[i];
            if (j > i) a[cell(count, i, j)] -= r.tie[i];
        }
        for (int k = 0; k < 2; ++k)
            if (ends.firm[k] && i == lit + 1 + k) {
                curvature *= FIRM;
                pull = curvature * (ends.end[k] - r.value[i]);
            }
        a[cell(count, i, i)] = curvature;
        a[cell(count, i, count)] = pull;
    }
    TOGETHER
}

// Gauss: rows of U, and of y beside it, of U x = y; row by row what is below it, so that a barrier a row is enough.
// False, to all items: not positive. What it leaves then means nothing.
static bool eliminate(MATRIX double *a, const int n)
{
    bool sound = true;
    for (int k = 0; k < n; ++k) {
        const double pivot = a[cell(n, k, k)];
        sound = sound && pivot > 0.0;
        for (int i = k + 1 + ITEM / ACROSS; i < n; i += GROUP / ACROSS) {
            const double by = a[cell(n, k, i)] / pivot;
            for (int j = i + ITEM % ACROSS; j <= n; j += ACROSS) a[cell(n, i, j)] -= by * a[cell(n, k, j)];
        }
        TOGETHER
    }
    return sound;
}

// x of U x = y, in the place of y.
static void substitute(MATRIX double *a, const int n)
{
    for (int i = n - 1; i > 0; --i) {
        const double x = a[cell(n, i, n)] / a[cell(n, i, i)];
        FOR_OWN(k, i) a[cell(n, k, n)] -= a[cell(n, k, i)] * x;
        TOGETHER
    }
    FOR_OWN(k, n) a[cell(n, k, n)] /= a[cell(n, k, k)];
    TOGETHER
}

// For Gauss-Newton: curvature and slope of the log posterior by the unknowns, before they are solved.
static void tell_normal(const Scene s, const int count, MATRIX const double *a, __global float *out)
{
    __global float *to = out + 16 + (4 + s.unknowns) * s.pixels + 2 * s.unknowns;
    FOR_OWN(k, count * count) to[k] = (float)a[cell_of(count, k / count, k % count)];
    FOR_OWN(i, count) to[s.unknowns * s.unknowns + i] = (float)a[cell(count, i, count)];
}

// The step of all unknowns, in the last column of `a`, `pull` before it: those that would leave their range (`firm`) to
// its end, and the others to their best with that, until no more would. Even light is no less than nothing, and no more
// of the sky is hidden than there is. False: not positive. `last`: logs of the determinants are taken, too; `details`,
// if there are any: the matrix.
static bool held_step(const Scene s, const Room r, const int lit, const int count, MATRIX double *a, Ends *ends,
    const int last, __global float *details)
{
    bool sound = true, more = true;
    for (int pass = 0; more; ++pass) {
        draw_normal(s, r, lit, count, *ends, a);
        if (details && pass == 0) tell_normal(s, count, a, details);
        FOR_OWN(i, pass ? 0 : count) r.pull[i] = a[cell(count, i, count)];
        TOGETHER
        const bool positive = eliminate(a, count);
        sound = sound && positive;
        FOR_OWN(i, last && !pass ? count : 0) r.logs[i] = log(a[cell(count, i, i)]) - log(r.precision[i]);
        substitute(a, count);
        more = false;
        for (int k = 0; k < 2; ++k) {
            const int m = lit + 1 + k;
            const double there = r.value[m] + a[cell(count, m, count)];
            const double end = clamp(there, 0.0, k ? 1.0 : DBL_MAX);
            if (sound && !ends->firm[k] && end != there) {
                ends->end[k] = end;
                more = ends->firm[k] = true;
            }
        }
    }
    return sound;
}
