// How much of a frame's brightness N matt bodies under one distant light and an even one leave over, each at its best.
//
// One work-item takes body after body: place its vertices, draw its faces into a z-buffer, spread the normals as the
// point spread does, gather the pixels that count, fit the light. The slow twin is service/imaging/shading.py
// (`explained`) on gpu/zbuffer.py. Coordinates are those of pixel centres: pixel (i, j) is the point (j, i).
//
// Built with ROUNDS of reweighting, EVERY how manieth pixel counts, OUTLIER medians beyond which one pulls no more than
// one there, and COVERED of a pixel, after the blur, from which on it counts.

#define PLANES 4     // x, y, z of the normals, and how far a pixel is covered
#define HALVINGS 20  // of the interval that holds a median

typedef struct {
    __global float *x, *y, *z;                  // vertices of all parts
    __global float *depth;                      // (side, side)
    __global int *face;                         // -1: none
    __global float *drawn, *blurred;            // (PLANES, side, stride); `drawn` has a border of `radius` on the left
    __global float *column;                     // (PLANES + 3, most): the pixels that count
    int side, stride, radius, most;
} View;

static View take_view(__global float *memory, const int vertices, const int side, const int radius)
{
    View v;
    v.side = side;
    v.radius = radius;
    v.stride = (side + 2 * radius + 2 * LANES - 1) / LANES * LANES;
    v.most = (side * side / EVERY + 2 * LANES) / LANES * LANES;
    v.x = memory;
    v.y = v.x + vertices + LANES;
    v.z = v.y + vertices + LANES;
    v.depth = v.z + vertices + LANES;
    v.face = (__global int *)(v.depth + side * side);
    v.drawn = v.depth + 2 * side * side;
    v.blurred = v.drawn + PLANES * side * v.stride;
    v.column = v.blurred + PLANES * side * v.stride;
    return v;
}

static void put(__global float *to, const floats values) { *(__global loose_floats *)to = values; }

static float sum_of(const floats a)
{
    const float8 eight = a.lo + a.hi;
    const float4 four = eight.lo + eight.hi;
    return (four.x + four.y) + (four.z + four.w);
}

static void place_vertices(
    const View v, __global const float *t, const int parts, __global const float *vertices, __global const int *start)
{
    const int all = start[parts];
    for (int part = 0; part < parts; ++part, t += 12)
        for (int k = start[part]; k < start[part + 1]; k += LANES) {  // what it writes too much, the next part overwrites
            const floats x = floats_at(vertices + k), y = floats_at(vertices + all + k);
            const floats z = floats_at(vertices + 2 * all + k);
            put(v.x + k, x * t[0] + y * t[1] + z * t[2] + (t[3] - 0.5f));
            put(v.y + k, x * t[4] + y * t[5] + z * t[6] + (t[7] - 0.5f));
            put(v.z + k, x * t[8] + y * t[9] + z * t[10] + t[11]);
        }
}

static int first_not_before(const float value, const int end) { return (int)ceil(clamp(value, 0.0f, (float)end)); }

static float across(const View v, const int upper, const int lower, const int row)
{
    return v.x[upper] + ((float)row - v.y[upper]) * ((v.x[lower] - v.x[upper]) / (v.y[lower] - v.y[upper]));
}

static void draw_face(const View v, const int number, const int4 face)
{
    int p = face.x, q = face.y, r = face.z;
    const float left = min(min(v.x[p], v.x[q]), v.x[r]), right = max(max(v.x[p], v.x[q]), v.x[r]);
    if (first_not_before(left, v.side) == first_not_before(right, v.side)) return;
    if (v.y[p] > v.y[q]) { const int swap = p; p = q; q = swap; }
    if (v.y[q] > v.y[r]) { const int swap = q; q = r; r = swap; }
    if (v.y[p] > v.y[q]) { const int swap = p; p = q; q = swap; }
    const int top = first_not_before(v.y[p], v.side), middle = first_not_before(v.y[q], v.side);
    const int bottom = first_not_before(v.y[r], v.side);
    if (top == bottom) return;
    const float3 a = {v.x[q] - v.x[p], v.y[q] - v.y[p], v.z[q] - v.z[p]};
    const float3 b = {v.x[r] - v.x[p], v.y[r] - v.y[p], v.z[r] - v.z[p]};
    const float area = a.x * b.y - a.y * b.x;
    if (area == 0.0f) return;
    const float right_z = (a.z * b.y - a.y * b.z) / area, down_z = (a.x * b.z - a.z * b.x) / area;
    // Seen edge-on, a plane is steep: rounding must not carry its depth past the face's own corners.
    const float near = min(min(v.z[p], v.z[q]), v.z[r]), far = max(max(v.z[p], v.z[q]), v.z[r]);
    for (int row = top; row < bottom; ++row) {
        const float one = across(v, p, r, row);
        const float two = row < middle ? across(v, p, q, row) : across(v, q, r, row);
        const int first = first_not_before(min(one, two), v.side), last = first_not_before(max(one, two), v.side);
        const float start = v.z[p] + ((float)row - v.y[p]) * down_z - v.x[p] * right_z;
        for (int column = first; column < last; ++column) {
            const float z = clamp(start + (float)column * right_z, near, far);
            const int pixel = row * v.side + column;
            if (z < v.depth[pixel]) {
                v.depth[pixel] = z;
                v.face[pixel] = number;
            }
        }
    }
}

static void draw_body(
    const View v, __global const float *transforms, const int parts, __global const float *vertices,
    __global const int *start, __global const int4 *faces, const int n_faces)
{
    for (int k = 0; k < v.side * v.side; ++k) {
        v.depth[k] = INFINITY;
        v.face[k] = -1;
    }
    place_vertices(v, transforms, parts, vertices, start);
    for (int f = 0; f < n_faces; ++f) draw_face(v, f, faces[f]);
}

// Unit normals, away from what is seen, and 1 where something is.
static void draw_normals(const View v, __global const int4 *faces)
{
    const int plane = v.side * v.stride;
    for (int k = 0; k < PLANES * plane; k += LANES) put(v.drawn + k, 0.0f);
    int before = -1;
    float3 normal = 0.0f;
    for (int row = 0; row < v.side; ++row)
        for (int column = 0; column < v.side; ++column) {
            const int f = v.face[row * v.side + column];
            if (f < 0) continue;
            if (f != before) {
                const int p = faces[f].x, q = faces[f].y, r = faces[f].z;
                const float3 a = {v.x[q] - v.x[p], v.y[q] - v.y[p], v.z[q] - v.z[p]};
                const float3 b = {v.x[r] - v.x[p], v.y[r] - v.y[p], v.z[r] - v.z[p]};
                const float3 c = cross(a, b);
                normal = -c / copysign(sqrt(dot(c, c)), c.z);
                before = f;
            }
            __global float *to = v.drawn + row * v.stride + v.radius + column;
            to[0] = normal.x;
            to[plane] = normal.y;
            to[2 * plane] = normal.z;
            to[3 * plane] = 1.0f;
        }
}

static int mirrored(int k, const int side)   // about the outermost pixels, as often as it takes
{
    while (k < 0 || k >= side) k = k < 0 ? -k : 2 * side - 2 - k;
    return k;
}

// `drawn`, spread by `taps` (2 radius + 1) along rows into `blurred`, then along columns back into `drawn`, without its
// border.
static void blur(const View v, __global const float *taps)
{
    const int end = 2 * v.radius + 1;
    for (int k = 0; k < PLANES * v.side; ++k) {
        __global float *row = v.drawn + k * v.stride, *out = v.blurred + k * v.stride;
        for (int j = 1; j <= v.radius; ++j) {
            row[v.radius - j] = row[v.radius + mirrored(-j, v.side)];
            row[v.radius + v.side - 1 + j] = row[v.radius + mirrored(v.side - 1 + j, v.side)];
        }
        for (int j = 0; j < v.side; j += LANES) {
            floats sum = 0.0f;
            for (int t = 0; t < end; ++t) sum += taps[t] * floats_at(row + j + t);
            put(out + j, sum);
        }
    }
    for (int plane = 0; plane < PLANES; ++plane) {
        __global const float *from = v.blurred + plane * v.side * v.stride;
        __global float *to = v.drawn + plane * v.side * v.stride;
        for (int row = 0; row < v.side; ++row)
            for (int j = 0; j < v.side; j += LANES) {
                floats sum = 0.0f;
                for (int t = 0; t < end; ++t)
                    sum += taps[t] * floats_at(from + mirrored(row + t - v.radius, v.side) * v.stride + j);
                put(to + row * v.stride + j, sum);
            }
    }
}

// Does the pixel, or one beside it, show light or the body?
static bool counts(const View v, __global const uchar *light, const int row, const int column)
{
    __global const float *covered = v.drawn + 3 * v.side * v.stride;
    for (int i = max(row - 1, 0); i <= min(row + 1, v.side - 1); ++i)
        for (int j = max(column - 1, 0); j <= min(column + 1, v.side - 1); ++j)
            if (light[i * v.side + j] || covered[i * v.stride + j] > COVERED) return true;
    return false;
}

// Into the columns: normal and coverage, and the brightness seen there. Their number; behind it, lanes of zeros.
static int gather(const View v, __global const float *brightness, __global const uchar *light)
{
    int found = 0, n = 0;
    for (int row = 0; row < v.side; ++row)
        for (int column = 0; column < v.side; ++column)
            if (counts(v, light, row, column) && found++ % EVERY == 0) {
                for (int k = 0; k < PLANES; ++k)
                    v.column[k * v.most + n] = v.drawn[(k * v.side + row) * v.stride + column];
                v.column[PLANES * v.most + n] = brightness[row * v.side + column];
                ++n;
            }
    for (int k = 0; k <= PLANES; ++k)
        for (int j = n; j < (n + LANES - 1) / LANES * LANES; ++j) v.column[k * v.most + j] = 0.0f;
    return n;
}

// The share that solves the ridged normal equations, by Cholesky's factors.
static void solve(double gram[PLANES][PLANES], double right[PLANES], float share[PLANES])
{
    double trace = 0.0, factor[PLANES][PLANES];
    for (int k = 0; k < PLANES; ++k) trace += gram[k][k];
    for (int i = 0; i < PLANES; ++i)
        for (int j = 0; j <= i; ++j) {
            double rest = gram[i][j] + (i == j ? 1e-6 * trace + 1e-12 : 0.0);
            for (int k = 0; k < j; ++k) rest -= factor[i][k] * factor[j][k];
            factor[i][j] = i == j ? sqrt(max(rest, 1e-9 * trace + 1e-12)) : rest / factor[j][j];
        }
    for (int i = 0; i < PLANES; ++i) {
        for (int k = 0; k < i; ++k) right[i] -= factor[i][k] * right[k];
        right[i] /= factor[i][i];
    }
    for (int i = PLANES - 1; i >= 0; --i) {
        for (int k = i + 1; k < PLANES; ++k) right[i] -= factor[k][i] * right[k];
        right[i] /= factor[i][i];
        share[i] = (float)right[i];
    }
}

// About the median of n values that are not negative; behind them, lanes of zeros.
static float median_of(__global const float *values, const int n, const float greatest)
{
    float low = 0.0f, high = greatest;
    for (int k = 0; k < HALVINGS; ++k) {
        const float half_way = 0.5f * (low + high);
        ints above = 0;
        for (int j = 0; j < n; j += LANES) above -= floats_at(values + j) > half_way;
        const int8 eight = above.lo + above.hi;
        const int4 four = eight.lo + eight.hi;
        if (2 * (four.x + four.y + four.z + four.w) > n) low = half_way;
        else high = half_way;
    }
    return high;
}

// The least sum of absolute residuals of n pixels, over the rounds, from one first guess of where the sun is.
static float fit_light(const View v, const int n, const float3 guess)
{
    __global const float *column = v.column, *seen = column + PLANES * v.most;
    __global float *left = v.column + (PLANES + 1) * v.most, *weight = v.column + (PLANES + 2) * v.most;
    float sun[3] = {guess.x, guess.y, guess.z}, least = INFINITY;
    for (int j = 0; j < n; j += LANES) put(weight + j, 1.0f);
    for (int round = 0; round < ROUNDS; ++round) {
        floats products[PLANES][PLANES], wanted[PLANES];
        for (int i = 0; i < PLANES; ++i) {
            wanted[i] = 0.0f;
            for (int k = 0; k < PLANES; ++k) products[i][k] = 0.0f;
        }
        for (int j = 0; j < n; j += LANES) {
            floats basis[PLANES];
            for (int k = 0; k < PLANES; ++k) basis[k] = floats_at(column + k * v.most + j);
            const ints lit = sun[0] * basis[0] + sun[1] * basis[1] + sun[2] * basis[2] > 0.0f;
            for (int k = 0; k < 3; ++k) basis[k] = lit ? basis[k] : 0.0f;
            for (int i = 0; i < PLANES; ++i) {
                const floats weighted = basis[i] * floats_at(weight + j);
                wanted[i] += weighted * floats_at(seen + j);
                for (int k = 0; k <= i; ++k) products[i][k] += weighted * basis[k];
            }
        }
        double gram[PLANES][PLANES], right[PLANES];
        for (int i = 0; i < PLANES; ++i) {
            right[i] = sum_of(wanted[i]);
            for (int k = 0; k <= i; ++k) gram[i][k] = sum_of(products[i][k]);
        }
        float share[PLANES];
        solve(gram, right, share);
        floats sum = 0.0f, most = 0.0f;
        for (int j = 0; j < n; j += LANES) {
            const floats x = floats_at(column + j), y = floats_at(column + v.most + j);
            const floats z = floats_at(column + 2 * v.most + j);
            const ints lit = sun[0] * x + sun[1] * y + sun[2] * z > 0.0f;
            const floats matt = share[0] * x + share[1] * y + share[2] * z;
            const floats bright = (lit ? matt : 0.0f) + share[3] * floats_at(column + 3 * v.most + j);
            const floats rest = fabs(floats_at(seen + j) - bright);
            put(left + j, rest);
            sum += rest;
            most = max(most, rest);
        }
        least = min(least, sum_of(sum));
        for (int k = 0; k < 3; ++k) sun[k] = share[k];
        if (round + 1 == ROUNDS) break;
        float greatest = 0.0f, each[LANES];
        vstore16(most, 0, each);
        for (int k = 0; k < LANES; ++k) greatest = max(greatest, each[k]);
        const float usual = OUTLIER * median_of(left, n, greatest) + 1e-9f;
        for (int j = 0; j < n; j += LANES) put(weight + j, 1.0f / max(1.0f, floats_at(left + j) / usual));
    }
    return least;
}

// sums (N, 2): of the brightness, absolute, where light or the body is seen, and of what the best light leaves of it.
__kernel void left_over(
    __global const float *transforms, const int bodies, const int parts, __global const float *vertices,
    __global const int *vertex_start, __global const int4 *faces, const int n_faces, const int side,
    __global const float *brightness, __global const uchar *light, __global const float *taps, const int radius,
    __global const float *guesses, const int n_guesses, __global float *sums, __global float *memory, const int each,
    volatile __global int *next)
{
    const View v = take_view(memory + get_global_id(0) * (size_t)each, vertex_start[parts], side, radius);
    for (int body = atomic_inc(next); body < bodies; body = atomic_inc(next)) {
        draw_body(v, transforms + (size_t)body * parts * 12, parts, vertices, vertex_start, faces, n_faces);
        draw_normals(v, faces);
        blur(v, taps);
        const int n = gather(v, brightness, light);
        floats total = 0.0f;
        for (int j = 0; j < n; j += LANES) total += fabs(floats_at(v.column + PLANES * v.most + j));
        float least = sum_of(total);
        sums[2 * body] = least;
        for (int k = 0; k < n_guesses; ++k) least = min(least, fit_light(v, n, vload3(k, guesses)));
        sums[2 * body + 1] = least;
    }
}

// The nearest face (-1: none) and its depth (N, side, side) at every pixel's centre.
__kernel void draw(
    __global const float *transforms, const int bodies, const int parts, __global const float *vertices,
    __global const int *vertex_start, __global const int4 *faces, const int n_faces, const int side,
    __global int *seen, __global float *depth, __global float *memory, const int each, volatile __global int *next)
{
    View v = take_view(memory + get_global_id(0) * (size_t)each, vertex_start[parts], side, 0);
    for (int body = atomic_inc(next); body < bodies; body = atomic_inc(next)) {
        v.face = seen + (size_t)body * side * side;
        v.depth = depth + (size_t)body * side * side;
        draw_body(v, transforms + (size_t)body * parts * 12, parts, vertices, vertex_start, faces, n_faces);
    }
}
