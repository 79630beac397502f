// Derivatives of N blurred pictures by what draws them: docs/model.md, section 3.
//
// The slow twin is service/inference/model/derivatives.py. One work-item takes pose after pose.

#define TILE 384  // pixels of a window that are summed at once: so much of a few pictures stays in the nearest cache

// Where any of some pictures is not zero. Empty: bottom <= top.
static Box box_of_any(__global const float *pictures, const int count, const int side, Box box)
{
    for (int k = 0; k < count; ++k, pictures += side * side)
        for (int row = 0; row < side; ++row)
            for (int column = 0; column < side; column += LANES)
                if (most_of(fabs(floats_at(pictures + row * side + column))) > 0.0f) {
                    box.top = min(box.top, row);
                    box.bottom = max(box.bottom, row + 1);
                    box.left = min(box.left, column);
                    box.right = max(box.right, column + LANES);
                }
    return box;
}

typedef struct {
    int side, components, length;
    __global const float *weights, *smooth, *slope;  // of the components of the blur; their taps, one after the other
    __global const int *radii;
    __global float *between;
} Blur;

// Adds `by` times a picture that is blurred, or whose slope across or down is, to `out`.
static void add_blurred(const Blur b, __global const float *picture, const Box box, const float by, const bool across,
    const bool down, __global float *out)
{
    int at = 0;
    for (int c = 0; c < b.components; at += 2 * b.radii[c] + 1, ++c)
        sweep(picture, b.side, box, b.side, by * b.weights[c], (down ? b.slope : b.smooth) + at,
            (across ? b.slope : b.smooth) + at, b.radii[c], b.between, b.length, out);
}

// A picture times its pixels' places along one axis.
static void times_place(__global const float *picture, const Box box, const int side, const float middle,
    const bool across, __global float *out)
{
    const floats lanes = convert_float16(lane_numbers()) + 0.5f - middle;
    for (int row = box.top; row < box.bottom; ++row)
        for (int column = box.left; column < box.right; column += LANES) {
            const floats place = across ? lanes + (float)column : (floats)((float)row + 0.5f - middle);
            put(out + row * side + column, place * floats_at(picture + row * side + column));
        }
}

// What a blurred picture loses by x and y (px), by growth, and by a turn of the picture from x to y.
static void draw_places(const Blur b, __global const float *here, const Box box, __global const float *middle,
    __global float *placed, __global float *out, const int pixels)
{
    add_blurred(b, here, box, -1.0f, true, false, out);
    add_blurred(b, here, box, -1.0f, false, true, out + pixels);
    add_blurred(b, here, box, 2.0f, false, false, out + 2 * pixels);
    times_place(here, box, b.side, middle[0], true, placed);
    add_blurred(b, placed, box, -1.0f, true, false, out + 2 * pixels);
    add_blurred(b, placed, box, -1.0f, false, true, out + 3 * pixels);
    times_place(here, box, b.side, middle[1], false, placed);
    add_blurred(b, placed, box, -1.0f, false, true, out + 2 * pixels);
    add_blurred(b, placed, box, 1.0f, true, false, out + 3 * pixels);
}

// pairs (N, 2, drawn, side, side): pictures on either side of a difference. here (N, side, side) between them, or null:
// no places. mixes (N, wanted, drawn + places): what each derivative is of the blurred differences, and of the places.
// middles (N, 2) of the bodies, px. out (N, wanted, side, side), zeros.
__kernel void slopes(__global const float *pairs, __global const float *here, const int poses, const int drawn,
    const int wanted, __global const float *mixes, __global const float *middles, const int side,
    const int components, __global const float *weights, __global const int *radii, __global const float *smooth,
    __global const float *slope, const int length, __global float *out, __global float *memory, const ulong each,
    volatile __global int *next)
{
    const int pixels = side * side, count = drawn + (here ? 4 : 0);
    __global float *pictures = memory + get_global_id(0) * each, *spare = pictures + count * pixels;
    const Blur b = {side, components, length, weights, smooth, slope, radii, spare + pixels};
    int radius = 0;
    for (int c = 0; c < components; ++c) radius = max(radius, radii[c]);
    for (int pose = atomic_inc(next); pose < poses; pose = atomic_inc(next)) {
        __global const float *plus = pairs + (size_t)pose * 2 * drawn * pixels, *minus = plus + drawn * pixels;
        Box box = {side, 0, side, 0};
        box = box_of_any(plus, 2 * drawn, side, box);
        if (here) box = box_of_any(here + (size_t)pose * pixels, 1, side, box);
        if (box.top >= box.bottom) continue;
        const Box wide = widened(box, radius, side);
        for (int k = 0; k < count; ++k) clear(pictures + k * pixels, wide, side);
        for (int k = 0; k < drawn; ++k) {
            for (int row = box.top; row < box.bottom; ++row)
                for (int at = row * side + box.left; at < row * side + box.right; at += LANES)
                    put(spare + at, floats_at(plus + k * pixels + at) - floats_at(minus + k * pixels + at));
            add_blurred(b, spare, box, 1.0f, false, false, pictures + k * pixels);
        }
        if (here)
            draw_places(b, here + (size_t)pose * pixels, box, middles + 2 * pose, spare, pictures + drawn * pixels,
                pixels);
        __global const float *mix = mixes + (size_t)pose * wanted * count;
        __global float *to = out + (size_t)pose * wanted * pixels;
        for (int d = 0; d < wanted; ++d, mix += count, to += pixels)
            for (int k = 0; k < count; ++k)
                if (mix[k] != 0.0f) add(to, pictures + k * pixels, wide, side, mix[k]);
    }
}

// Adds the products of some rows of a picture, `stride` apart, with each of `wanted` others, which are `area` apart and
// `wide` from row to row, to as many sums of LANES; four at a time.
static void add_dots(__global const float *picture, const int stride, __global const float *others, const int area,
    const int rows, const int wide, const int wanted, __global float *sums)
{
    for (int d = 0; d < wanted; d += 4, others += 4 * area, sums += 4 * LANES) {
        floats a = floats_at(sums), b = floats_at(sums + LANES);
        floats c = floats_at(sums + 2 * LANES), e = floats_at(sums + 3 * LANES);
        for (int row = 0; row < rows; ++row)
            for (int k = 0; k < wide; k += LANES) {
                const floats left = floats_at(picture + row * stride + k);
                __global const float *other = others + row * wide + k;
                a = fma(left, floats_at(other), a);
                b = fma(left, floats_at(other + area), b);
                c = fma(left, floats_at(other + 2 * area), c);
                e = fma(left, floats_at(other + 3 * area), e);
            }
        put(sums, a);
        put(sums + LANES, b);
        put(sums + 2 * LANES, c);
        put(sums + 3 * LANES, e);
    }
}

// taken (wanted, wanted) = C' A^-1 C of a factorised A (count, count), its rows `width` apart, and crosses C (count,
// padded). `inner` has `width` numbers.
static void take_away(__global const double *factor, const int count, const int width, __global const double *crosses,
    const int padded, const int wanted, __global double *inner, __global double *taken)
{
    for (int d = 0; d < wanted; ++d) {
        for (int m = 0; m < width; ++m) inner[m] = m < count ? crosses[m * padded + d] : 0.0;
        solve(factor, count, width, inner);
        for (int e = 0; e < wanted; ++e) {
            double sum = 0.0;
            for (int m = 0; m < count; ++m) sum += crosses[m * padded + e] * inner[m];
            taken[e * wanted + d] = sum;
        }
    }
}

// What the slopes (N, wanted, side, side) of poses say of them, the light's unknowns eliminated. rows: of each pose
// `size` numbers at `which`, as the evidence tells them (`told_size`), of `unknowns` at the most. known (N, planes): of
// each positive plane's paint, or null. Zeros to begin with: normal, taken and unpainted (N, wanted, wanted), pull (N,
// wanted). Where the curvature of the light is not positive nothing is taken; without its paint, what is with it.
__kernel void systems(__global const float *rows, const ulong size, __global const int *which, const int poses,
    const int unknowns, const int side, __global const float *slopes, const int wanted, __global const double *known,
    const int planes, __global double *normal, __global double *taken, __global double *unpainted,
    __global double *pull, __global float *memory, const ulong each, volatile __global int *next)
{
    const int pixels = side * side, padded = (wanted + 3) & ~3, widest = (unknowns + EIGHT - 1) & -EIGHT;
    memory += get_global_id(0) * each;
    // sums of products with weighted slopes: of the light's pictures, of the slopes, and of the residual
    const int crossed = unknowns * padded, among = wanted * padded, whole = crossed + among + padded;
    __global double *factor = (__global double *)memory, *inner = factor + widest * widest, *crosses = inner + widest;
    __global double *own = crosses + crossed, *left_over = own + among;
    __global float *sums = (__global float *)(left_over + padded), *weighted = sums + whole * LANES;
    for (int pose = atomic_inc(next); pose < poses; pose = atomic_inc(next)) {
        __global const float *row = rows + which[pose] * size, *residual = row + LANES, *weight = residual + pixels;
        __global const float *columns = residual + 4 * pixels;
        __global const float *steep = columns + (size_t)unknowns * pixels + 2 * unknowns;
        __global const float *push = steep + unknowns * unknowns, *lit = push + unknowns;
        const int count = (int)row[0], top = (int)row[1], bottom = (int)row[2], left = (int)row[3];
        const int wide = (int)row[4] - left, width = (count + EIGHT - 1) & -EIGHT;
        if (bottom <= top || wide <= 0) continue;
        const int tall = max(TILE / wide, 1), area = tall * wide, square = pose * wanted * wanted;
        for (int k = 0; k < whole; ++k) put(sums + k * LANES, 0.0f);
        for (int d = wanted; d < padded; ++d)
            for (int k = 0; k < area; k += LANES) put(weighted + d * area + k, 0.0f);
        for (int first = top; first < bottom; first += tall) {
            const int lines = min(tall, bottom - first), at = first * side + left;
            __global const float *slope = slopes + (size_t)pose * wanted * pixels + at;
            for (int d = 0; d < wanted; ++d)
                for (int r = 0; r < lines; ++r)
                    for (int k = 0; k < wide; k += LANES)
                        put(weighted + d * area + r * wide + k,
                            floats_at(weight + at + r * side + k) * floats_at(slope + d * pixels + r * side + k));
            for (int m = 0; m < count; ++m)
                add_dots(columns + ((size_t)m * (bottom - top) + first - top) * wide, wide, weighted, area, lines, wide,
                    wanted, sums + m * padded * LANES);
            for (int d = 0; d < wanted; ++d)
                add_dots(slope + d * pixels, side, weighted, area, lines, wide, wanted,
                    sums + (crossed + d * padded) * LANES);
            add_dots(residual + at, side, weighted, area, lines, wide, wanted,
                sums + (crossed + among) * LANES);
        }
        for (int k = 0; k < whole; ++k) crosses[k] = (double)sum_of(floats_at(sums + k * LANES));
        for (int d = 0; d < wanted; ++d) {
            pull[pose * wanted + d] = left_over[d];
            for (int e = 0; e < wanted; ++e) normal[square + d * wanted + e] = own[d * padded + e];
        }
        for (int again = 0; again < (known ? 2 : 1); ++again) {
            for (int i = 0; i < count; ++i)
                for (int j = 0; j < width; ++j) factor[i * width + j] = j < count ? (double)steep[i * count + j] : 0.0;
            for (int i = 0; again && i < count - (unknowns - planes); ++i)
                factor[i * width + i] -= known[pose * planes + (int)lit[i]];
            if (!factorise(factor, count, width)) break;
            take_away(factor, count, width, crosses, padded, wanted, inner, unpainted + square);
            if (again) break;
            for (int k = 0; k < wanted * wanted; ++k) taken[square + k] = unpainted[square + k];
            for (int m = 0; m < width; ++m) inner[m] = m < count ? (double)push[m] : 0.0;
            solve(factor, count, width, inner);
            for (int d = 0; d < wanted; ++d)
                for (int m = 0; m < count; ++m) pull[pose * wanted + d] -= crosses[m * padded + d] * inner[m];
        }
    }
}
