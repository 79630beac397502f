// Pictures of (side, side), side a multiple of LANES: their boxes, blur and slopes.
//
// A picture's `box` is where it may be other than zero; its columns are whole lanes. Outside of it nothing is read.

typedef struct { int top, bottom, left, right; } Box;

static void put(__global float *to, const floats values) { *(__global loose_floats *)to = values; }

static float sum_of(const floats a)
{
    const float8 eight = a.lo + a.hi;
    const float4 four = eight.lo + eight.hi;
    return (four.x + four.y) + (four.z + four.w);
}

static float most_of(const floats a)
{
    const float8 eight = fmax(a.lo, a.hi);
    const float4 four = fmax(eight.lo, eight.hi);
    return fmax(fmax(four.x, four.y), fmax(four.z, four.w));
}

static Box common(const Box a, const Box b)
{
    const Box c = {max(a.top, b.top), min(a.bottom, b.bottom), max(a.left, b.left), min(a.right, b.right)};
    return c;
}

// `radius` pixels more on every side, as far as there are any.
static Box widened(const Box box, const int radius, const int side)
{
    const Box wide = {max(box.top - radius, 0), min(box.bottom + radius, side),
        max((box.left - radius) & -LANES, 0), min((box.right + radius + LANES - 1) & -LANES, side)};
    return wide;
}

static floats most_in_row(__global const float *row, const int left, const int right)
{
    floats most = 0.0f;
    for (int k = left; k < right; k += LANES) most = fmax(most, floats_at(row + k));
    return most;
}

// Where in `within` a picture, nowhere negative, is above zero; empty (bottom <= top) unless it is above `least`
// somewhere. It is read once: what was drawn comes from far away. `columns` has room for a row.
static Box box_of(__global const float *picture, const Box within, const int side, const float least,
    __global float *columns)
{
    floats most = 0.0f;
    Box box = {within.bottom, within.top, within.left, within.right};
    for (int k = within.left; k < within.right; k += LANES) put(columns + k, 0.0f);
    for (int row = within.top; row < within.bottom; ++row) {
        floats bright = 0.0f;
        for (int k = within.left; k < within.right; k += LANES) {
            const floats here = floats_at(picture + row * side + k);
            put(columns + k, fmax(floats_at(columns + k), here));
            bright = fmax(bright, here);
        }
        most = fmax(most, bright);
        if (most_of(bright) > 0.0f) {
            box.top = min(box.top, row);
            box.bottom = row + 1;
        }
    }
    if (!(most_of(most) > least)) box.bottom = box.top;
    while (box.left < box.right && most_of(floats_at(columns + box.left)) == 0.0f) box.left += LANES;
    while (box.left < box.right && most_of(floats_at(columns + box.right - LANES)) == 0.0f) box.right -= LANES;
    return box;
}

static void clear(__global float *picture, const Box box, const int side)
{
    for (int row = box.top; row < box.bottom; ++row)
        for (int k = box.left; k < box.right; k += LANES) put(picture + row * side + k, 0.0f);
}

static void add(__global float *to, __global const float *picture, const Box box, const int side, const float by)
{
    for (int row = box.top; row < box.bottom; ++row)
        for (int k = row * side + box.left; k < row * side + box.right; k += LANES)
            put(to + k, fma((floats)by, floats_at(picture + k), floats_at(to + k)));
}

static float dot_in(__global const float *a, __global const float *b, const Box box, const int side)
{
    floats sum = 0.0f;
    for (int row = box.top; row < box.bottom; ++row)
        for (int k = row * side + box.left; k < row * side + box.right; k += LANES)
            sum = fma(floats_at(a + k), floats_at(b + k), sum);
    return sum_of(sum);
}

// Adds weight * (picture, whose rows are `apart`, swept by 2 radius + 1 taps along each axis) to `out`. `between` has
// `side` rows of `length` numbers: the picture swept downwards, with room on both sides for what the sweep across reads
// beyond it.
static void sweep(__global const float *picture, const int apart, const Box box, const int side, const float weight,
    __global const float *down, __global const float *taps, const int radius, __global float *between,
    const int length, __global float *out)
{
    const Box wide = widened(box, radius, side);
    const int margin = (radius + LANES - 1) & -LANES;
    for (int row = wide.top; row < wide.bottom; ++row) {
        const int first = max(row - radius, box.top), last = min(row + radius, box.bottom - 1);
        __global float *line = between + row * length + margin;
        for (int k = wide.left - margin; k < box.left; k += LANES) put(line + k, 0.0f);
        for (int k = box.left; k < box.right; k += LANES) {
            floats sum = 0.0f;
            for (int r = first; r <= last; ++r)
                sum = fma((floats)down[r - row + radius], floats_at(picture + r * apart + k), sum);
            put(line + k, weight * sum);
        }
        for (int k = box.right; k < wide.right + margin; k += LANES) put(line + k, 0.0f);
    }
    for (int row = wide.top; row < wide.bottom; ++row)
        for (int k = wide.left; k < wide.right; k += LANES) {
            __global const float *from = between + row * length + margin + k - radius;
            floats sum = floats_at(out + row * side + k), other = taps[2 * radius] * floats_at(from + 2 * radius);
            for (int t = 0; t < 2 * radius; t += 2) {
                sum = fma((floats)taps[t], floats_at(from + t), sum);
                other = fma((floats)taps[t + 1], floats_at(from + t + 1), other);
            }
            put(out + row * side + k, sum + other);
        }
}

// Central differences in a box beyond which the picture is zero; zero at the borders of the patch.
static void slope_across(__global const float *picture, const Box box, const int side, __global float *out)
{
    const ints lane = lane_numbers();
    for (int row = box.top; row < box.bottom; ++row) {
        floats before = 0.0f, here = floats_at(picture + row * side + box.left);
        for (int k = box.left; k < box.right; k += LANES) {
            const floats after = k + LANES < box.right ? floats_at(picture + row * side + k + LANES) : (floats)0.0f;
            const floats left = (floats)(before.sf, here.s0, here.s12, here.s3456, here.s789a, here.sbcde);
            const floats right = (floats)(here.s1234, here.s5678, here.s9abc, here.sde, here.sf, after.s0);
            const floats slope = 0.5f * (right - left);
            put(out + row * side + k, (lane + k == 0) | (lane + k == side - 1) ? 0.0f : slope);
            before = here;
            here = after;
        }
    }
}

static void slope_down(__global const float *picture, const Box box, const int side, __global float *out)
{
    for (int row = box.top; row < box.bottom; ++row) {
        const bool border = row == 0 || row == side - 1;
        const float up = row > box.top && !border ? 0.5f : 0.0f, down = row + 1 < box.bottom && !border ? 0.5f : 0.0f;
        __global const float *above = picture + max(row - 1, box.top) * side;
        __global const float *below = picture + min(row + 1, box.bottom - 1) * side;
        for (int k = box.left; k < box.right; k += LANES)
            put(out + row * side + k, down * floats_at(below + k) - up * floats_at(above + k));
    }
}
