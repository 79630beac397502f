// Derivatives of N blurred pictures by what draws them: docs/model.md, section 3.
//
// The slow twin is service/inference/model/derivatives.py. One work-item takes pose after pose.

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
        sweep(picture, box, b.side, by * b.weights[c], (down ? b.slope : b.smooth) + at,
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
