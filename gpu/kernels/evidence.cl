// The light of N drawn poses against one patch of a frame: linear unknowns at their best, and their Laplace evidence.
//
// docs/model.md, section 3; the slow twin is service/inference/model/likelihood.py. One work-item takes pose after
// pose. Pictures are (side, side), side a multiple of LANES; a picture's `box` is where it is not zero, its columns
// whole lanes. Linear algebra is in double: the unknowns' curvatures span ten orders of magnitude.
#pragma OPENCL EXTENSION cl_khr_fp64 : enable

#define NU 4.0f
#define HERMITE 12
#define BUMPS 9
#define LEAST_LIT 1e-4f
#define LONGEST_STEP 1.5

typedef struct { int top, bottom, left, right; } Box;

typedef struct {
    int side, pixels, planes, positives, unknowns, speckle, shifts, rounds, components;
    float sigma2, photon, hidden, area, wrong, edge2, width, gain;
} Scene;

static void put(__global float *to, const floats values) { *(__global loose_floats *)to = values; }

static float sum_of(const floats a)
{
    const float8 eight = a.lo + a.hi;
    const float4 four = eight.lo + eight.hi;
    return (four.x + four.y) + (four.z + four.w);
}

static Box common(const Box a, const Box b)
{
    const Box c = {max(a.top, b.top), min(a.bottom, b.bottom), max(a.left, b.left), min(a.right, b.right)};
    return c;
}

static Box box_of(__global const float *picture, const int side)
{
    Box box = {side, 0, side, 0};
    for (int row = 0; row < side; ++row)
        for (int column = 0; column < side; column += LANES) {
            if (sum_of(fabs(floats_at(picture + row * side + column))) == 0.0f) continue;
            box.top = min(box.top, row);
            box.bottom = row + 1;
            box.left = min(box.left, column);
            box.right = max(box.right, column + LANES);
        }
    return box;
}

// Adds weight * (picture blurred along both axes by 2 radius + 1 taps) to `out`. `line` holds side + 2 radius + LANES
// numbers, the first and last `radius` of them zero; `between` is a picture.
static Box blur(__global const float *picture, const Box box, const int side, const float weight,
    __global const float *taps, const int radius, __global float *line, __global float *between, __global float *out)
{
    const Box wide = {max(box.top - radius, 0), min(box.bottom + radius, side),
        max(box.left - radius, 0) & -LANES, min((box.right + radius + LANES - 1) & -LANES, side)};
    for (int k = 0; k < side + 2 * radius + LANES; ++k) line[k] = 0.0f;
    for (int row = box.top; row < box.bottom; ++row) {
        for (int k = box.left; k < box.right; k += LANES) put(line + radius + k, floats_at(picture + row * side + k));
        for (int k = wide.left; k < wide.right; k += LANES) {
            floats sum = 0.0f;
            for (int t = 0; t <= 2 * radius; ++t) sum += taps[t] * floats_at(line + k + t);
            put(between + row * side + k, sum);
        }
    }
    for (int row = wide.top; row < wide.bottom; ++row) {
        const int first = max(row - radius, box.top), last = min(row + radius, box.bottom - 1);
        for (int k = wide.left; k < wide.right; k += LANES) {
            floats sum = 0.0f;
            for (int r = first; r <= last; ++r) sum += taps[r - row + radius] * floats_at(between + r * side + k);
            put(out + row * side + k, floats_at(out + row * side + k) + weight * sum);
        }
    }
    return wide;
}

static void slope_across(__global const float *picture, const int side, __global float *out)
{
    for (int row = 0; row < side; ++row) {
        __global const float *from = picture + row * side;
        __global float *to = out + row * side;
        to[0] = to[side - 1] = 0.0f;
        for (int k = 1; k < side - 1; ++k) to[k] = 0.5f * (from[k + 1] - from[k - 1]);
    }
}

static void slope_down(__global const float *picture, const int side, __global float *out)
{
    for (int k = 0; k < side; k += LANES) {
        put(out + k, 0.0f);
        put(out + (side - 1) * side + k, 0.0f);
    }
    for (int row = 1; row < side - 1; ++row)
        for (int k = 0; k < side; k += LANES)
            put(out + row * side + k,
                0.5f * (floats_at(picture + (row + 1) * side + k) - floats_at(picture + (row - 1) * side + k)));
}

// Gauss-Hermite deviations of the point spread, orders 2 to 4: width^n d^n I / sqrt(a! b!), as the twin orders them.
static void draw_speckle(__global const float *light, const int side, const float width, __global float *spare,
    __global float *out)
{
    const float factorial[5] = {1, 1, 2, 6, 24};
    const int pixels = side * side;
    int slot = 0;
    for (int order = 2; order <= 4; ++order)
        for (int b = 0; b <= order; ++b, ++slot) {
            __global const float *from = light;
            int turn = 0;
            for (int k = 0; k < order; ++k) {
                __global float *to = k == order - 1 ? out + slot * pixels : spare + turn * pixels;
                if (k < order - b) slope_across(from, side, to);
                else slope_down(from, side, to);
                from = to;
                turn ^= 1;
            }
            const float factor = pown(width, order) / sqrt(factorial[order - b] * factorial[b]);
            for (int k = 0; k < pixels; k += LANES)
                put(out + slot * pixels + k, factor * floats_at(out + slot * pixels + k));
        }
}

// Cholesky factor of the lower half of (n, n), in place. False: not positive.
static bool factorise(__global double *a, const int n)
{
    for (int j = 0; j < n; ++j) {
        double pivot = a[j * n + j];
        for (int k = 0; k < j; ++k) pivot -= a[j * n + k] * a[j * n + k];
        if (!(pivot > 0.0)) return false;
        pivot = sqrt(pivot);
        a[j * n + j] = pivot;
        for (int i = j + 1; i < n; ++i) {
            double sum = a[i * n + j];
            for (int k = 0; k < j; ++k) sum -= a[i * n + k] * a[j * n + k];
            a[i * n + j] = sum / pivot;
        }
    }
    return true;
}

static void solve(__global const double *factor, const int n, __global double *x)
{
    for (int i = 0; i < n; ++i) {
        for (int k = 0; k < i; ++k) x[i] -= factor[i * n + k] * x[k];
        x[i] /= factor[i * n + i];
    }
    for (int i = n - 1; i >= 0; --i) {
        for (int k = i + 1; k < n; ++k) x[i] -= factor[k * n + i] * x[k];
        x[i] /= factor[i * n + i];
    }
}

typedef struct {
    __global float *pictures;   // (unknowns, pixels): of each unknown, before its scale
    __global float *light, *model, *residual, *weight, *weighed, *across, *down, *spare;  // (pixels); spare two
    __global float *line;
    __global float *scale;      // (unknowns)
    __global Box *box;          // (unknowns)
    __global int *plane;        // (positives) which plane each lit one is
    __global double *value, *mean, *precision, *move;  // (unknowns)
    __global double *normal;    // (unknowns, unknowns)
} Room;

static Room room_in(__global float *memory, const Scene s, const int longest)
{
    Room r;
    r.normal = (__global double *)memory;
    r.value = r.normal + s.unknowns * s.unknowns;
    r.mean = r.value + s.unknowns;
    r.precision = r.mean + s.unknowns;
    r.move = r.precision + s.unknowns;
    r.pictures = (__global float *)(r.move + s.unknowns);
    r.light = r.pictures + s.unknowns * s.pixels;
    r.model = r.light + s.pixels;
    r.residual = r.model + s.pixels;
    r.weight = r.residual + s.pixels;
    r.weighed = r.weight + s.pixels;
    r.across = r.weighed + s.pixels;
    r.down = r.across + s.pixels;
    r.spare = r.down + s.pixels;
    r.line = r.spare + 2 * s.pixels;
    r.scale = r.line + longest;
    r.box = (__global Box *)(r.scale + s.unknowns);
    r.plane = (__global int *)(r.box + s.unknowns);
    return r;
}

static void add(__global float *to, __global const float *picture, const Box box, const int side, const float by)
{
    for (int row = box.top; row < box.bottom; ++row)
        for (int k = box.left; k < box.right; k += LANES)
            put(to + row * side + k, floats_at(to + row * side + k) + by * floats_at(picture + row * side + k));
}

static float dot_in(__global const float *a, __global const float *b, const Box box, const int side)
{
    floats sum = 0.0f;
    for (int row = box.top; row < box.bottom; ++row)
        for (int k = box.left; k < box.right; k += LANES)
            sum += floats_at(a + row * side + k) * floats_at(b + row * side + k);
    return sum_of(sum);
}

// Scales, light, model, residual, weight. `lit` positives are in use; the others' places are those behind them.
static void draw_model(const Scene s, const Room r, const int lit, const int count, __global const float *offset,
    __global const float *data, __global const uchar *full, __global const float *bumps)
{
    const float gain = (float)exp(r.value[lit]);
    for (int k = 0; k < s.pixels; k += LANES) put(r.light + k, 0.0f);
    for (int m = 0; m < lit; ++m) {
        r.scale[m] = gain * (float)exp(r.value[m] + (double)offset[r.plane[m]]);
        add(r.light, r.pictures + m * s.pixels, r.box[m], s.side, r.scale[m]);
    }
    r.scale[lit] = 1.0f;                                    // the gain: its picture is the light
    r.scale[lit + 1] = gain;                                // even light
    r.scale[lit + 2] = -s.hidden;                           // sky that the body hides: the same picture
    add(r.light, r.pictures + (lit + 1) * s.pixels, r.box[lit + 1], s.side, gain * (float)r.value[lit + 1]);
    for (int k = 0; k < s.pixels; k += LANES) {
        put(r.pictures + lit * s.pixels + k, floats_at(r.light + k));
        put(r.model + k, floats_at(r.light + k));
    }
    add(r.model, r.pictures + (lit + 1) * s.pixels, r.box[lit + 1], s.side, r.scale[lit + 2] * (float)r.value[lit + 2]);
    slope_across(r.light, s.side, r.across);
    slope_down(r.light, s.side, r.down);
    int m = lit + 3;
    for (int k = 0; k < 3; ++k, ++m) r.scale[m] = 1.0f;
    if (s.speckle) {
        draw_speckle(r.light, s.side, s.width, r.spare, r.pictures + m * s.pixels);
        for (int k = 0; k < HERMITE; ++k) r.scale[m++] = 1.0f;
    }
    if (s.shifts)
        for (int way = 0; way < 2; ++way)
            for (int b = 0; b < BUMPS; ++b, ++m) {
                __global const float *slope = way ? r.down : r.across;
                for (int k = 0; k < s.pixels; k += LANES)
                    put(r.pictures + m * s.pixels + k, floats_at(bumps + b * s.pixels + k) * floats_at(slope + k));
                r.scale[m] = 1.0f;
            }
    for (int k = lit + 3; k < count; ++k)
        add(r.model, r.pictures + k * s.pixels, r.box[k], s.side, r.scale[k] * (float)r.value[k]);
    for (int k = 0; k < s.pixels; k += LANES) {
        const floats light = floats_at(r.light + k), dx = floats_at(r.across + k), dy = floats_at(r.down + k);
        const floats bright = light > 0.0f ? light : 0.0f;
        const floats variance = (s.sigma2 + s.photon * bright) / s.area
            + s.wrong * (light * light + s.edge2 * (dx * dx + dy * dy));
        floats residual = floats_at(data + k) - floats_at(r.model + k);
        const ints censored = convert_int16(vload16(0, full + k)) != 0;
        residual = censored & (residual < 0.0f) ? 0.0f : residual;
        put(r.residual + k, residual);
        put(r.spare + k, variance);
        put(r.weight + k, (NU + 1.0f) / ((NU * variance + residual * residual) * s.area));
    }
}

// The lower half of J' W J, each unknown's picture times its scale, and J' W r into `move`.
static void draw_normal(const Scene s, const Room r, const int count)
{
    for (int i = 0; i < count; ++i) {
        const Box mine = r.box[i];
        __global const float *picture = r.pictures + i * s.pixels;
        for (int row = mine.top; row < mine.bottom; ++row)
            for (int k = mine.left; k < mine.right; k += LANES)
                put(r.weighed + row * s.side + k,
                    floats_at(r.weight + row * s.side + k) * floats_at(picture + row * s.side + k));
        r.move[i] = (double)r.scale[i] * (double)dot_in(r.weighed, r.residual, mine, s.side);
        for (int j = 0; j <= i; ++j) {
            const Box both = common(mine, r.box[j]);
            const double sum = (double)dot_in(r.weighed, r.pictures + j * s.pixels, both, s.side);
            r.normal[i * count + j] = (double)r.scale[i] * (double)r.scale[j] * sum;
        }
    }
}

// Into `r`: the pictures of the unknowns, their priors and first values. How many positives are lit.
static int begin(const Scene s, const Room r, __global const float *planes, __global const float *offset,
    __global const float *given_mean, __global const float *given_precision, __global const float *data,
    __global const float *slopes, __global const float *weights, __global const int *radii,
    __global const float *taps, const int positives_first)
{
    const Box all = {0, s.side, 0, s.side};
    int lit = 0;
    for (int p = 0; p < s.planes; ++p) {
        const bool even = p == positives_first;
        if (even) continue;
        const Box box = box_of(planes + (size_t)p * s.pixels, s.side);
        if (box.bottom <= box.top) continue;
        __global float *out = r.pictures + lit * s.pixels;
        for (int k = 0; k < s.pixels; k += LANES) put(out + k, 0.0f);
        Box wide = box;
        __global const float *line = taps;
        for (int c = 0; c < s.components; ++c) {
            const Box one = blur(planes + (size_t)p * s.pixels, box, s.side, weights[c], line, radii[c], r.line, r.spare, out);
            wide.top = min(wide.top, one.top); wide.bottom = max(wide.bottom, one.bottom);
            wide.left = min(wide.left, one.left); wide.right = max(wide.right, one.right);
            line += 2 * radii[c] + 1;
        }
        floats most = 0.0f;
        for (int row = wide.top; row < wide.bottom; ++row)
            for (int k = wide.left; k < wide.right; k += LANES) {
                const floats here = floats_at(out + row * s.side + k);
                most = most > here ? most : here;
            }
        float top[LANES], highest = 0.0f;
        vstore16(most, 0, top);
        for (int k = 0; k < LANES; ++k) highest = max(highest, top[k]);
        if (highest <= LEAST_LIT) continue;
        const int number = p < positives_first ? p : p - 1;
        r.plane[lit] = number;
        r.box[lit] = wide;
        r.mean[lit] = 0.0;
        r.precision[lit] = (double)given_precision[number];
        ++lit;
    }
    __global float *even = r.pictures + (lit + 1) * s.pixels;
    for (int k = 0; k < s.pixels; k += LANES) put(even + k, 0.0f);
    const Box box = box_of(planes + (size_t)positives_first * s.pixels, s.side);
    if (box.bottom > box.top) {
        __global const float *line = taps;
        for (int c = 0; c < s.components; ++c) {
            blur(planes + (size_t)positives_first * s.pixels, box, s.side, weights[c], line, radii[c], r.line, r.spare, even);
            line += 2 * radii[c] + 1;
        }
    }
    for (int k = 0; k < s.pixels; k += LANES) put(even + s.pixels + k, floats_at(even + k));
    for (int k = 0; k < 3 * s.pixels; k += LANES) put(even + 2 * s.pixels + k, floats_at(slopes + k));
    const int more = 6 + (s.speckle ? HERMITE : 0) + (s.shifts ? 2 * BUMPS : 0);
    for (int k = 0; k < more; ++k) {
        r.mean[lit + k] = (double)given_mean[s.positives + k];
        r.precision[lit + k] = (double)given_precision[s.positives + k];
        r.box[lit + k] = all;
    }
    for (int k = 0; k < lit + more; ++k) r.value[k] = r.mean[k];
    // The gain by least squares, everything else at its prior.
    for (int k = 0; k < s.pixels; k += LANES) put(r.light + k, 0.0f);
    for (int m = 0; m < lit; ++m)
        add(r.light, r.pictures + m * s.pixels, r.box[m], s.side, exp(offset[r.plane[m]]));
    add(r.light, even, all, s.side, (float)r.mean[lit + 1]);
    const float power = dot_in(r.light, r.light, all, s.side), likeness = dot_in(r.light, data, all, s.side);
    if (power > 0.0f && likeness > 0.0f)
        r.value[lit] = (double)clamp(log(likeness / power), s.gain - 4.0f, s.gain + 4.0f);
    return lit;
}

// out (N, 4): log evidence, chi2 of the body, log det, squared deviation; values (N, planes) what `combined` takes.
__kernel void evidence(
    __global const float *planes, const int poses, __global const float *offset, __global const float *given_mean,
    __global const float *given_precision, __global const float *data, __global const uchar *full,
    __global const float *slopes, __global const float *bumps, __global const float *weights,
    __global const int *radii, __global const float *taps, const int groups, const int side, const int n_planes,
    const int speckle, const int shifts, const int rounds, const int components, const float sigma2,
    const float photon, const float hidden, const float area, const float wrong, const float edge2,
    const float width, const float gain, __global float *out, __global float *coefficients,
    __global float *details, __global float *memory, const int each, const int longest,
    volatile __global int *next)
{
    const int most = n_planes - 1 + 6 + (speckle ? HERMITE : 0) + (shifts ? 2 * BUMPS : 0);
    const Scene s = {side, side * side, n_planes, n_planes - 1, most, speckle, shifts, rounds, components,
        sigma2, photon, hidden, area, wrong, edge2, width, gain};
    const Room r = room_in(memory + get_global_id(0) * (size_t)each, s, longest);
    for (int pose = atomic_inc(next); pose < poses; pose = atomic_inc(next)) {
        const int lit = begin(s, r, planes + (size_t)pose * n_planes * s.pixels, offset, given_mean, given_precision,
            data, slopes, weights, radii, taps, groups);
        const int count = lit + most - s.positives;
        draw_model(s, r, lit, count, offset, data, full, bumps);
        for (int round = 0; round < rounds; ++round) {
            draw_normal(s, r, count);
            for (int k = 0; k < count; ++k) {
                r.normal[k * count + k] += r.precision[k];
                r.move[k] -= r.precision[k] * (r.value[k] - r.mean[k]);
            }
            if (!factorise(r.normal, count)) break;
            solve(r.normal, count, r.move);
            for (int k = 0; k < count; ++k)
                r.value[k] += k <= lit ? clamp(r.move[k], -LONGEST_STEP, LONGEST_STEP) : r.move[k];
            draw_model(s, r, lit, count, offset, data, full, bumps);
        }
        draw_normal(s, r, count);
        double logdet = 0.0, squares = 0.0;
        for (int i = 0; i < count; ++i) {
            for (int j = 0; j <= i; ++j) r.normal[i * count + j] /= sqrt(r.precision[i] * r.precision[j]);
            r.normal[i * count + i] += 1.0;
            squares += r.precision[i] * (r.value[i] - r.mean[i]) * (r.value[i] - r.mean[i]);
        }
        const bool sound = factorise(r.normal, count);
        for (int i = 0; i < count; ++i) logdet += 2.0 * log(r.normal[i * count + i]);
        floats sum = 0.0f, misfit = 0.0f, body = 0.0f;
        double total = 0.0;
        for (int row = 0; row < side; ++row) {
            sum = 0.0f;
            for (int k = row * side; k < (row + 1) * side; k += LANES) {
                const floats residual = floats_at(r.residual + k), variance = floats_at(r.spare + k);
                const floats light = floats_at(r.light + k), part = residual * residual / variance;
                sum -= 0.5f * log(variance) + 0.5f * (NU + 1.0f) * log1p(part / NU);
                const ints on = light * light > sigma2 / area;
                misfit += on ? part : 0.0f;
                body += on ? 1.0f : 0.0f;
            }
            total += (double)sum_of(sum);
        }
        const double density = lgamma(0.5 * (NU + 1.0)) - lgamma(0.5 * NU) - 0.5 * log(NU * M_PI);
        const double value = (total + density * s.pixels) / area - 0.5 * squares - 0.5 * logdet;
        const float bodies = sum_of(body);
        out[4 * pose] = sound ? (float)value : -INFINITY;
        out[4 * pose + 1] = bodies > 0.0f ? sum_of(misfit) / bodies : 0.0f;
        out[4 * pose + 2] = (float)logdet;
        out[4 * pose + 3] = (float)squares;
        __global float *drawn = coefficients + (size_t)pose * n_planes;
        const float bright = (float)exp(r.value[lit]);
        for (int p = 0; p < s.positives; ++p) drawn[p < groups ? p : p + 1] = bright * exp(offset[p]);
        for (int m = 0; m < lit; ++m) drawn[r.plane[m] < groups ? r.plane[m] : r.plane[m] + 1] = r.scale[m];
        drawn[groups] = bright * (float)r.value[lit + 1] - hidden * (float)r.value[lit + 2];
        if (details) {  // count; residual, weight, model, light; then every scaled picture, precision, deviation
            const size_t size = LANES + (size_t)(4 + s.unknowns) * s.pixels + 2 * s.unknowns;
            __global float *to = details + pose * size + LANES;
            details[pose * size] = count;
            for (int k = 0; k < s.pixels; ++k) {
                to[k] = r.residual[k];
                to[s.pixels + k] = r.weight[k];
                to[2 * s.pixels + k] = r.model[k];
                to[3 * s.pixels + k] = r.light[k];
            }
            to += 4 * s.pixels;
            for (int i = 0; i < count; ++i) {
                __global float *column = to + i * s.pixels;
                for (int k = 0; k < s.pixels; ++k) column[k] = 0.0f;
                add(column, r.pictures + i * s.pixels, r.box[i], side, r.scale[i]);
            }
            to += s.unknowns * s.pixels;
            for (int i = 0; i < count; ++i) {
                to[i] = (float)r.precision[i];
                to[s.unknowns + i] = (float)(r.value[i] - r.mean[i]);
            }
        }
    }
}
