// Sums over pixels of the products of every two pictures, and the linear algebra on them.
//
// The sums are taken tile by tile, a lane of columns wide and so tall that the pictures in it stay in the nearest
// cache; in a tile only pictures whose boxes reach it count, four times four of them at once. Linear algebra is in
// double: the unknowns' curvatures span ten orders of magnitude. Rows of matrices are padded to EIGHT.

#define EIGHT 8
#define NEAR 704  // rows of a lane each that the nearest cache holds

// 32 units of rows are a side at the least.
static int unit_of(const int side) { return max(4, (side + 31) / 32); }

// Of one lane of columns: bit k is set if a picture is above `least` in the k-th unit of its rows.
static uint reach_of(__global const float *picture, const Box box, const int side, const int column, const float least)
{
    const int unit = unit_of(side);
    uint reach = 0;
    for (int row = box.top; row < box.bottom;) {
        const int k = row / unit;
        floats most = 0.0f;
        for (; row < min((k + 1) * unit, box.bottom); ++row)
            most = fmax(most, fabs(floats_at(picture + row * side + column)));
        if (most_of(most) > least) reach |= 1u << k;
    }
    return reach;
}

// The least box of whole units around a box.
static Box in_units(Box box, const int side)
{
    const int unit = unit_of(side);
    box.top -= box.top % unit;
    box.bottom = min((box.bottom + unit - 1) / unit * unit, side);
    return box;
}

// The bits of rows `top` to `bottom`.
static uint units_of(const int side, const int top, const int bottom)
{
    if (top >= bottom) return 0;
    const int first = top / unit_of(side), last = (bottom - 1) / unit_of(side);
    return (2u << last) - (1u << first);
}

typedef struct {
    __global float *pictures;     // (slots, stride)
    __global uint *reach;         // (slots, lanes of a side): bit k is set if the picture reaches the k-th UNIT of rows
    __global const float *root;   // a picture: square roots of the weights
    __global float *tile;         // what the nearest cache holds: the pictures of one tile, each times the root
    __global float *sums;         // (slots + 1, slots + 1, LANES)
    __global int *reaching;       // (slots + 3) which pictures reach a tile
    int side, stride;
} Products;

static void add_to(__global float *sum, const floats more) { put(sum, floats_at(sum) + more); }

// Adds the products of four pictures with four others, each `apart` numbers from the next, to rows of sums.
static void add_sixteen(__global const float *left, __global const float *right, const int rows, const int apart,
    __global float *sums, const int width, const int4 i, const int4 j)
{
    floats a0 = 0.0f, a1 = 0.0f, a2 = 0.0f, a3 = 0.0f, b0 = 0.0f, b1 = 0.0f, b2 = 0.0f, b3 = 0.0f;
    floats c0 = 0.0f, c1 = 0.0f, c2 = 0.0f, c3 = 0.0f, d0 = 0.0f, d1 = 0.0f, d2 = 0.0f, d3 = 0.0f;
    for (int row = 0; row < rows; ++row, left += LANES, right += LANES) {
        const floats a = floats_at(left), b = floats_at(left + apart);
        const floats c = floats_at(left + 2 * apart), d = floats_at(left + 3 * apart);
        const floats p = floats_at(right), q = floats_at(right + apart);
        const floats r = floats_at(right + 2 * apart), s = floats_at(right + 3 * apart);
        a0 = fma(a, p, a0); a1 = fma(a, q, a1); a2 = fma(a, r, a2); a3 = fma(a, s, a3);
        b0 = fma(b, p, b0); b1 = fma(b, q, b1); b2 = fma(b, r, b2); b3 = fma(b, s, b3);
        c0 = fma(c, p, c0); c1 = fma(c, q, c1); c2 = fma(c, r, c2); c3 = fma(c, s, c3);
        d0 = fma(d, p, d0); d1 = fma(d, q, d1); d2 = fma(d, r, d2); d3 = fma(d, s, d3);
    }
    const int4 k = j * LANES;
    __global float *a = sums + i.x * width, *b = sums + i.y * width, *c = sums + i.z * width, *d = sums + i.w * width;
    add_to(a + k.x, a0); add_to(a + k.y, a1); add_to(a + k.z, a2); add_to(a + k.w, a3);
    add_to(b + k.x, b0); add_to(b + k.y, b1); add_to(b + k.z, b2); add_to(b + k.w, b3);
    add_to(c + k.x, c0); add_to(c + k.y, c1); add_to(c + k.z, c2); add_to(c + k.w, c3);
    add_to(d + k.x, d0); add_to(d + k.y, d1); add_to(d + k.z, d2); add_to(d + k.w, d3);
}

// sums[i][j] += weight * picture i * picture j in a tile, i >= j, of the `n` pictures that reach it. What has no
// partner in a block of four goes to the row and column behind the last slot.
static void add_tile(const Products p, const int slots, const int top, const int rows, const int column, const int n)
{
    const int at = top * p.side + column, apart = rows * LANES;
    for (int a = 0; a < n; ++a) {
        __global const float *picture = p.pictures + p.reaching[a] * p.stride + at;
        __global float *to = p.tile + a * apart;
        for (int row = 0; row < rows; ++row)
            put(to + row * LANES, floats_at(p.root + at + row * p.side) * floats_at(picture + row * p.side));
    }
    for (int a = n; a < n + 3; ++a) p.reaching[a] = slots;
    for (int a = 0; a < n; a += 4)
        for (int b = 0; b <= a; b += 4)
            add_sixteen(p.tile + a * apart, p.tile + b * apart, rows, apart, p.sums, (slots + 1) * LANES,
                vload4(0, p.reaching + a), vload4(0, p.reaching + b));
}

// Rows of a tile at the most, of so many pictures or more.
static int tile_rows(const int slots) { return max(NEAR / slots, EIGHT); }

// total (slots, slots): sums over all pixels of weight * picture i * picture j; both halves.
static void products(const Products p, const int slots, const Box body, __global double *total)
{
    const int tall = tile_rows(slots), lanes = p.side / LANES;
    for (int i = 0; i < slots; ++i)
        for (int j = 0; j <= i; ++j) put(p.sums + (i * (slots + 1) + j) * LANES, 0.0f);
    for (int column = 0; column < p.side; column += LANES) {
        int top = 0;
        while (top < p.side) {
            // Tiles end where the body does: beyond it there is sky alone.
            const int end = top < body.top ? body.top : top < body.bottom ? body.bottom : p.side;
            const int tiles = (end - top + tall - 1) / tall, rows = (end - top + tiles - 1) / tiles;
            const uint units = units_of(p.side, top, top + rows);
            int n = 0;
            for (int i = 0; i < slots; ++i) {
                p.reaching[n] = i;
                n += (p.reach[i * lanes + column / LANES] & units) != 0;
            }
            add_tile(p, slots, top, rows, column, n);
            top += rows;
        }
    }
    for (int i = 0; i < slots; ++i)
        for (int j = 0; j <= i; ++j)
            total[i * slots + j] = total[j * slots + i]
                = (double)sum_of(floats_at(p.sums + (i * (slots + 1) + j) * LANES));
}

static double sum_of_eight(const double8 a)
{
    const double4 four = a.lo + a.hi;
    return (four.x + four.y) + (four.z + four.w);
}

// Cholesky: a = U' U of the upper half of (n, n), rows `width` apart, in place. False: not positive. A row is finished
// from all those above it, sixteen columns at once, so that nothing is written twice.
static bool factorise(__global double *a, const int n, const int width)
{
    for (int k = 0; k < n; ++k) {
        __global double *row = a + k * width;
        for (int j = k & -EIGHT; j < n; j += 2 * EIGHT) {
            const bool both = j + EIGHT < n;
            double8 left = vload8(0, row + j), right = both ? vload8(0, row + j + EIGHT) : (double8)0.0;
            for (int m = 0; m < k; ++m) {
                __global const double *above = a + m * width;
                const double8 by = -above[k];
                left = fma(by, vload8(0, above + j), left);
                if (both) right = fma(by, vload8(0, above + j + EIGHT), right);
            }
            vstore8(left, 0, row + j);
            if (both) vstore8(right, 0, row + j + EIGHT);
        }
        if (!(row[k] > 0.0)) return false;
        const double inverse = 1.0 / sqrt(row[k]);
        for (int j = k & -EIGHT; j < n; j += EIGHT) vstore8(inverse * vload8(0, row + j), 0, row + j);
    }
    return true;
}

// x of U' U x = x, in place; x and the rows of U are `width` long, x zero from n on.
static void solve(__global const double *factor, const int n, const int width, __global double *x)
{
    for (int i = 0; i < n; ++i) {
        x[i] /= factor[i * width + i];
        const double by = x[i];
        for (int k = i + 1; k < n; ++k) x[k] -= by * factor[i * width + k];
    }
    for (int i = n - 1; i >= 0; --i) {
        double8 sum = 0.0;
        for (int k = (i + 1 + EIGHT - 1) & -EIGHT; k < n; k += EIGHT)
            sum = fma(vload8(0, factor + i * width + k), vload8(0, x + k), sum);
        double rest = sum_of_eight(sum);
        for (int k = i + 1; k < min((i + 1 + EIGHT - 1) & -EIGHT, n); ++k) rest += factor[i * width + k] * x[k];
        x[i] = (x[i] - rest) / factor[i * width + i];
    }
}
