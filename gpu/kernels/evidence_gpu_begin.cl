// The first launches of evidence_gpu_room.cl: boxes, blurred planes, priors and first values.

// Where a pose covers anything, and the box beyond which it changes nothing: a group a pose.
__kernel GROUPS void cover(ASKED, __global const float *planes, __global const int *radii)
{
    volatile __local int ends[4];
    SCENE
    __global const float *covered = planes + ((size_t)s.drawn * s.planes + s.groups) * s.pixels;
    FOR_OWN(k, 4) ends[k] = k % 2 ? 0 : s.side;
    FOR_OWN(p, s.positives) r.shows[p] = 0;
    TOGETHER
    FOR_OWN(k, s.pixels)
        if (covered[k] > 0.0f) {
            atomic_min(ends, k / s.side);
            atomic_max(ends + 1, k / s.side + 1);
            atomic_min(ends + 2, k % s.side);
            atomic_max(ends + 3, k % s.side + 1);
        }
    TOGETHER
    if (ITEM == 0) {
        int radius = 0;
        for (int c = 0; c < s.components; ++c) radius = max(radius, radii[s.component + c]);
        const Box some = {ends[0], ends[1], ends[2], ends[3]}, none = {0, 0, 0, 0};
        const Box cover = some.top < some.bottom ? some : none;
        const Box body = some.top < some.bottom ? widened(some, radius + (s.speckle ? 4 : 1), s.side) : none;
        const int told[8] = {cover.top, cover.bottom, cover.left, cover.right,
            body.top, body.bottom, body.left, body.right};
        for (int k = 0; k < 8; ++k) r.told[COVER + k] = told[k];
    }
}

// The taps of a component of the point spread.
static __global const float *taps_of(const Scene s, __global const int *radii, __global const float *taps, const int c)
{
    int at = s.tap;
    for (int before = 0; before < c; ++before) at += 2 * radii[s.component + before] + 1;
    return taps + at;
}

// One component of the point spread, downwards: an item a pixel of a plane.
__kernel GROUPS void blur_down(ASKED, __global const float *planes, __global const int *radii,
    __global const float *taps, const int c)
{
    SCENE
    const int plane = (int)get_global_id(0) / s.pixels, k = (int)get_global_id(0) % s.pixels;
    const int row = k / s.side, column = k % s.side;
    const Box box = box_at(r, COVER);
    if (c >= s.components || row >= s.side || column < box.left || column >= box.right) return;
    const int radius = radii[s.component + c];
    __global const float *from = planes + ((size_t)s.drawn * s.planes + plane) * s.pixels;
    __global const float *by = taps_of(s, radii, taps, c);
    float sum = 0.0f;
    for (int y = max(row - radius, box.top); y < min(row + radius + 1, box.bottom); ++y)
        sum = fma(by[y - row + radius], from[y * s.side + column], sum);
    r.between[plane * s.pixels + k] = sum;
}

// The same across, added to what the components before it have left.
__kernel GROUPS void blur_across(ASKED, __global const float *weights, __global const int *radii,
    __global const float *taps, const int c)
{
    SCENE
    const int plane = (int)get_global_id(0) / s.pixels, k = (int)get_global_id(0) % s.pixels;
    const int row = k / s.side, column = k % s.side;
    if (c >= s.components || !within(box_at(r, BODY), row, column)) return;
    const Box box = box_at(r, COVER);
    const int radius = radii[s.component + c];
    const bool even = plane >= s.groups && plane < s.groups + EVEN_PLANES;
    const int slot = even ? EVEN + plane - s.groups : s.first + (plane < s.groups ? plane : plane - EVEN_PLANES);
    __global const float *by = taps_of(s, radii, taps, c), *from = r.between + plane * s.pixels + row * s.side;
    __global float *to = picture_in(s, r, slot) + k;
    float sum = 0.0f;
    for (int x = max(column - radius, box.left); x < min(column + radius + 1, box.right); ++x)
        sum = fma(by[x - column + radius], from[x], sum);
    const float whole = fma(weights[s.component + c], sum, c ? *to : 0.0f);
    *to = whole;
    if (c == s.components - 1 && !even && whole > LEAST_LIT) r.shows[slot - s.first] = 1;  // whoever is the first
}

// How bright an unknown's picture is in the light, from where the unknowns are.
static void draw_scales(const Scene s, const Room r, const int lit, __global const float *offset)
{
    const float gain = (float)exp(r.value[lit]);
    FOR_OWN(m, lit + 9) {
        if (m < lit) r.scale[m] = gain * (float)exp(r.value[m] + (double)offset[r.plane[m]]);
        else if (m == lit + 1) r.scale[m] = gain;
        else if (m == lit + 2) r.scale[m] = -s.hidden;
        else r.scale[m] = m < lit + 6 ? 1.0f : exp(s.gain);
    }
}

// Scales of the Gauss-Hermite deviations: width^n / sqrt(a! b!).
static void draw_widths(const Scene s, const Room r, const int lit)
{
    const float factorial[5] = {1, 1, 2, 6, 24};
    int m = lit + 9;
    for (int order = 2; order <= 4; ++order)
        for (int b = 0; b <= order; ++b)
            r.scale[m++] = pown(s.width, order) / sqrt(factorial[order - b] * factorial[b]);
}

// Which positives are lit, priors and first values: `start`, or where there is none the prior's and the gain that fits
// best with it. A group a pose.
__kernel GROUPS void start(ASKED, __global const float *given_mean, __global const float *given_precision,
    __global const float *given_start, __global const int *pieces, __global const float *ties,
    __global const float *offset, __global const float *data)
{
    __local double8 sums[GROUP];
    SCENE
    const Box body = box_at(r, BODY);
    int lit = 0;
    for (int p = 0; p < s.positives; ++p) {
        if (r.shows[p] && ITEM == 0) r.plane[lit] = p;
        lit += r.shows[p];
    }
    TOGETHER
    __global const float *mean = given_mean + (size_t)s.pose * s.every;
    __global const float *precision = given_precision + (size_t)s.pose * s.every;
    __global const float *at = given_start + (size_t)s.pose * s.unknowns;
    FOR_OWN(m, lit + s.unknowns - s.positives) {
        const int k = m < lit ? r.plane[m] : m - lit + s.positives;
        r.mean[m] = (double)mean[k];
        r.precision[m] = (double)precision[k];
    }
    TOGETHER
    if (ITEM == 0)
        tie_facets(facets_of(s.positives, pieces, ties, mean, precision), r.plane, lit, r.precision, r.mean, r.tie,
            r.kin);
    TOGETHER
    FOR_OWN(m, lit + s.unknowns - s.positives) {
        const int k = m < lit ? r.plane[m] : m - lit + s.positives;
        r.value[m] = s.started ? (double)at[k] : r.mean[m];
        r.scale[m] = m < lit ? exp(offset[k] + (float)r.mean[m]) : 1.0f;  // of positives for now: there is no gain yet
    }
    TOGETHER
    double power = 0.0, likeness = 0.0;
    FOR_OWN(own, area_of(body)) {
        const int k = pixel_of(body, s.side, own);
        float light = (float)r.mean[lit + 1] * picture_in(s, r, EVEN)[k];
        for (int m = 0; m < lit; ++m) light = fma(r.scale[m], positive_in(s, r, m)[k], light);
        power += (double)(light * light);
        likeness += (double)(light * data[k]);
    }
    const double8 sum = sum_of_all(sums, (double8)(power, likeness, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0));
    if (ITEM == 0) {
        if (!s.started && sum.s0 > 0.0 && sum.s1 > 0.0)
            r.value[lit] = (double)clamp((float)log(sum.s1 / sum.s0), s.gain - 4.0f, s.gain + 4.0f);
        if (s.speckle) draw_widths(s, r, lit);
        r.told[LIT] = lit;
        r.told[GOING] = 1;
        r.paces[0] = 1.0;
        r.paces[1] = 0.0;
    }
    TOGETHER
    draw_scales(s, r, lit, offset);
}
