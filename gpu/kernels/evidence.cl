// The light of N drawn poses against one patch of a frame: linear unknowns at their best, and their Laplace evidence.
//
// docs/model.md, section 3; the slow twin is service/inference/model/likelihood.py. One work-item takes pose after
// pose. What a body can change of a frame lies in one box, `body`: beyond it there is sky alone.

#define FAINT 1e-4f  // of the noise: where no pixel of a tile may show more of a picture, it is left out there
#define ODD 5  // lanes between pictures: at whole pages apart they would push each other out of the nearest cache

typedef struct {
    int side, pixels, stride, planes, positives, unknowns, speckle, shifts, rounds, components, first, length, stars;
    float sigma2, photon, hidden, area, wrong, edge2, width, gain, star;
} Scene;

typedef struct {
    __global float *pictures;   // (slots, stride): of each unknown, before its scale
    __global Box *box;          // (slots)
    __global float *light, *across, *down, *model, *root, *variance;  // pictures; root: of weights
    __global float *between;    // (side, length)
    __global float *scale;      // (unknowns)
    __global int *plane, *kin;  // (positives) which plane each lit one is, and the first lit one of its piece
    // (unknowns); last: the move before; tie: see evidence_facets.cl
    __global double *value, *mean, *precision, *move, *pull, *last, *tie;
    __global double *total;     // (slots, slots)
    __global double *normal;    // (unknowns, unknowns)
    Products products;
} Room;

static __global float *take(__global float **memory, const int count)
{
    __global float *taken = *memory;
    *memory += (count + LANES - 1) & -LANES;
    return taken;
}

// In the order in which LightEvidence counts it.
static Room room_in(__global float *memory, const Scene s)
{
    const int width = (s.unknowns + EIGHT - 1) & -EIGHT, slots = s.unknowns - 1;
    Room r;
    r.normal = (__global double *)take(&memory, 2 * width * width);
    r.total = (__global double *)take(&memory, 2 * slots * slots);
    r.value = (__global double *)take(&memory, 2 * width);
    r.mean = (__global double *)take(&memory, 2 * width);
    r.precision = (__global double *)take(&memory, 2 * width);
    r.move = (__global double *)take(&memory, 2 * width);
    r.pull = (__global double *)take(&memory, 2 * width);
    r.last = (__global double *)take(&memory, 2 * width);
    r.tie = (__global double *)take(&memory, 2 * width);
    r.pictures = take(&memory, slots * s.stride);
    r.light = take(&memory, s.pixels);
    r.across = take(&memory, s.pixels);
    r.down = take(&memory, s.pixels);
    r.model = take(&memory, s.pixels);
    r.root = take(&memory, s.pixels);
    r.variance = take(&memory, s.pixels);
    r.between = take(&memory, s.side * s.length);
    r.scale = take(&memory, s.unknowns);
    r.box = (__global Box *)take(&memory, 4 * slots);
    r.plane = (__global int *)take(&memory, s.unknowns);
    r.kin = (__global int *)take(&memory, s.unknowns);
    r.products.pictures = r.pictures;
    r.products.root = r.root;
    r.products.reach = (__global uint *)take(&memory, slots * (s.side / LANES));
    r.products.tile = take(&memory, 2 * max(NEAR, (slots + 3) * EIGHT) * LANES);
    r.products.sums = take(&memory, (slots + 1) * (slots + 1) * LANES);
    r.products.reaching = (__global int *)take(&memory, slots + 3);
    r.products.side = s.side;
    r.products.stride = s.stride;
    return r;
}

static __global float *picture_in(const Scene s, const Room r, const int slot) { return r.pictures + slot * s.stride; }

// The slot of unknown m of a pose of which `lit` positives are in use; the gain (m == lit) has none.
static int slot_of(const Scene s, const int lit, const int m)
{
    if (m < lit) return s.first + m;
    if (m < lit + 3) return EVEN;
    if (m < lit + 6) return SKY + m - lit - 3;
    return m < lit + 9 ? TILT + m - lit - 6 : SPECKLE + m - lit - 9;
}

// Gauss-Hermite deviations of the point spread, orders 2 to 4: d^n I, each from one an order lower; their scale is
// width^n / sqrt(a! b!).
static void draw_speckle(const Scene s, const Room r, const Box body)
{
    int slot = SPECKLE;
    for (int order = 2; order <= 4; ++order)
        for (int b = 0; b <= order; ++b, ++slot) {
            const int before = slot - order - (b > 0);  // the same, one slope less: across, or if there are any down
            __global const float *from = order > 2 ? picture_in(s, r, before) : b < 2 ? r.across : r.down;
            if (b == 0) slope_across(from, body, s.side, picture_in(s, r, slot));
            else slope_down(from, body, s.side, picture_in(s, r, slot));
        }
}

// Log of what pixels lose by their residuals.
static floats loss_of(const floats residual, const floats variance)
{
    return 0.5f * (NU + 1.0f) * log(1.0f + residual * residual / (NU * variance));
}

// Which of sixteen pixels are of a piece, and brighter than the model.
static ints brighter_in(__global const uchar *marks, const int piece, const floats residual)
{
    return (convert_int16(vload16(0, marks)) >> 1 == piece) & (residual > 0.0f);
}

// Each piece of light that is not connected with the object's may be a star's, which adds to what the body leaves:
// where it does, a model of less light is no contradiction, and tells nothing. Nats by which that betters them all.
static float weigh_stars(const Scene s, const Room r, __global const uchar *marks, __global const int *boxes)
{
    __global const float *residuals = picture_in(s, r, RESIDUAL);
    float gained = 0.0f;
    for (int piece = 0; piece < s.stars; ++piece, boxes += 5) {
        floats lost = 0.0f;
        for (int row = boxes[1]; row < boxes[2]; ++row)
            for (int k = row * s.side + boxes[3]; k < row * s.side + boxes[4]; k += LANES) {
                const floats residual = floats_at(residuals + k);
                const ints brighter = brighter_in(marks + k, boxes[0], residual);
                lost += brighter ? loss_of(residual, floats_at(r.variance + k)) : 0.0f;
            }
        const float better = sum_of(lost) / s.area - s.star;
        const float root = sqrt(1.0f / (1.0f + exp(better)));  // of the share that it is the body's
        gained += better > 0.0f ? better + log1p(exp(-better)) : log1p(exp(better));
        for (int row = boxes[1]; row < boxes[2]; ++row)
            for (int k = row * s.side + boxes[3]; k < row * s.side + boxes[4]; k += LANES) {
                const ints brighter = brighter_in(marks + k, boxes[0], floats_at(residuals + k));
                put(r.root + k, floats_at(r.root + k) * (brighter ? root : 1.0f));
            }
    }
    return gained;
}

// Scales, light, model, residual, weight; what `weigh_stars` says. `lit` positives are in use.
static float draw_model(const Scene s, const Room r, const int lit, const int count, const Box body,
    __global const float *offset, __global const float *data, __global const uchar *marks, __global const float *behind,
    __global const float *bumps, __global const int *stars)
{
    const float gain = (float)exp(r.value[lit]);
    clear(r.light, body, s.side);
    for (int m = 0; m < lit; ++m) {
        r.scale[m] = gain * (float)exp(r.value[m] + (double)offset[r.plane[m]]);
        add(r.light, picture_in(s, r, s.first + m), r.box[s.first + m], s.side, r.scale[m]);
    }
    r.scale[lit] = 1.0f;
    r.scale[lit + 1] = gain;
    r.scale[lit + 2] = -s.hidden;
    add(r.light, picture_in(s, r, EVEN), body, s.side, gain * (float)r.value[lit + 1]);
    for (int k = 0; k < 3; ++k) {
        r.scale[lit + 6 + k] = exp(s.gain);  // not with the gain: a body of dark paint could hide in its even light
        add(r.light, picture_in(s, r, TILT + k), body, s.side, r.scale[lit + 6 + k] * (float)r.value[lit + 6 + k]);
    }
    slope_across(r.light, body, s.side, r.across);
    slope_down(r.light, body, s.side, r.down);
    if (s.speckle) draw_speckle(s, r, body);
    if (s.shifts)
        for (int b = 0; b < 2 * BUMPS; ++b) {
            __global const float *slope = b < BUMPS ? r.across : r.down, *bump = bumps + b % BUMPS * s.pixels;
            __global float *to = picture_in(s, r, SPECKLE + HERMITE * s.speckle + b);
            for (int row = body.top; row < body.bottom; ++row)
                for (int k = row * s.side + body.left; k < row * s.side + body.right; k += LANES)
                    put(to + k, floats_at(bump + k) * floats_at(slope + k));
        }
    const float level = (float)r.value[lit + 3], right = (float)r.value[lit + 4], low = (float)r.value[lit + 5];
    const float hidden = r.scale[lit + 2] * (float)r.value[lit + 2];
    __global const float *sky = picture_in(s, r, SKY), *even = picture_in(s, r, EVEN);
    __global float *residuals = picture_in(s, r, RESIDUAL);
    for (int row = 0; row < s.side; ++row)
        for (int column = 0; column < s.side; column += LANES) {
            const int k = row * s.side + column;
            const floats light = floats_at(r.light + k);
            floats model = light + level * floats_at(sky + k);
            model = fma((floats)right, floats_at(sky + s.stride + k), model);
            model = fma((floats)low, floats_at(sky + 2 * s.stride + k), model);
            floats variance = s.sigma2 / s.area;
            if (row >= body.top && row < body.bottom && column >= body.left && column < body.right) {
                const floats dx = floats_at(r.across + k), dy = floats_at(r.down + k);
                variance += s.photon / s.area * fmax(light, 0.0f)
                    + s.wrong * (light * light + s.edge2 * (dx * dx + dy * dy));
                model = fma(hidden * floats_at(behind + k), floats_at(even + k), model);
                for (int m = lit + 9; m < count; ++m)
                    model = fma((floats)(r.scale[m] * (float)r.value[m]),
                        floats_at(picture_in(s, r, SPECKLE + m - lit - 9) + k), model);
            }
            floats residual = floats_at(data + k) - model;
            const ints censored = (convert_int16(vload16(0, marks + k)) & 1) != 0;
            residual = censored & (residual < 0.0f) ? 0.0f : residual;
            floats weight = ((NU + 1.0f) / s.area) / (NU * variance + residual * residual);
            // At least so much light: more is no contradiction, and tells nothing.
            weight *= censored ? fmin(residual / sqrt(variance), 1.0f) : 1.0f;
            put(r.model + k, model);
            put(residuals + k, residual);
            put(r.variance + k, variance);
            put(r.root + k, sqrt(weight));
        }
    return weigh_stars(s, r, marks, stars);
}

// Of a row of unknowns those from `first` to `end`: sums of products, each times both scales.
static void draw_scaled(const double scale, __global const float *scales, __global const double *total,
    const int first, const int end, __global double *row)
{
    int j = first;
    for (; j + EIGHT <= end; j += EIGHT)
        vstore8(scale * convert_double8(vload8(0, scales + j)) * vload8(0, total + j - first), 0, row + j);
    for (; j < end; ++j) row[j] = scale * (double)scales[j] * total[j - first];
}

// The upper half of J' W J + P, and J' W r - P (value - mean) into `move`, from the sums of products.
static void draw_normal(const Scene s, const Room r, const int lit, const int count)
{
    const int slots = s.first + lit, width = (count + EIGHT - 1) & -EIGHT;
    for (int i = 0; i < count; ++i) {
        __global double *row = r.normal + i * width;
        for (int j = 0; j < width; j += EIGHT) vstore8((double8)0.0, 0, row + j);
        if (i == lit) continue;
        __global const double *total = r.total + slot_of(s, lit, i) * slots;
        const double scale = (double)r.scale[i];
        // Slots of positives follow each other, as those of the sky, the tilt and the speckle do.
        draw_scaled(scale, r.scale, total + s.first, 0, lit, row);
        row[lit + 1] = scale * (double)r.scale[lit + 1] * total[EVEN];
        row[lit + 2] = scale * (double)r.scale[lit + 2] * total[EVEN];
        draw_scaled(scale, r.scale, total + SKY, lit + 3, lit + 6, row);
        draw_scaled(scale, r.scale, total + TILT, lit + 6, lit + 9, row);
        draw_scaled(scale, r.scale, total + SPECKLE, lit + 9, count, row);
        r.move[i] = scale * total[RESIDUAL];
    }
    // The gain's picture is the sum of those of all positives and of the even light's share.
    double curvature = 0.0, pull = 0.0;
    __global double *gain = r.normal + lit * width;
    for (int m = 0; m < lit + 2; ++m) {
        if (m == lit) continue;
        const double share = m < lit ? 1.0 : r.value[m];
        pull += share * r.move[m];
        for (int j = 0; j < count; ++j) gain[j] += share * r.normal[m * width + j];
    }
    for (int m = 0; m < lit; ++m) curvature += gain[m];
    gain[lit] = curvature + r.value[lit + 1] * gain[lit + 1];
    r.move[lit] = pull;
    for (int i = 0; i < count; ++i) {
        r.normal[i * width + lit] = gain[i];
        r.normal[i * width + i] += r.precision[i];
        r.move[i] -= r.precision[i] * (r.value[i] - r.mean[i]);
    }
    for (int i = 0; i < lit; ++i)
        for (int j = r.kin[i]; r.tie[i] > 0.0 && j < lit && r.kin[j] == r.kin[i]; ++j) {
            r.normal[i * width + j] -= r.tie[i];
            r.move[i] += r.tie[i] * (r.value[j] - r.mean[j]);
        }
    for (int i = count; i < width; ++i) r.move[i] = 0.0;
}

// Even light is no less than nothing, and no more of the sky is hidden than there is: whether a step takes unknown `k`
// beyond its end, and the end. A sky that a body brightens would be light without a discrepancy.
static bool leaves(const Room r, const int lit, const int k, double *end)
{
    const double there = r.value[k] + r.move[k];
    *end = clamp(there, 0.0, k == lit + 2 ? 1.0 : DBL_MAX);
    return *end != there;
}

// The step of all unknowns from their normal matrix and pull: those that would leave their range (`firm`) to its end,
// and the others to their best with that, until no more would. `factorised`: the matrix is. False: not positive.
static bool held_step(const Scene s, const Room r, const int lit, const int count, const int row, bool factorised,
    bool *firm)
{
    double end[2];
    firm[0] = firm[1] = false;
    for (bool more = true; more;) {
        for (int i = 0, k = lit + 1; i < 2; ++i, ++k)
            if (firm[i]) {
                r.normal[k * row + k] *= FIRM;
                r.move[k] = r.normal[k * row + k] * (end[i] - r.value[k]);
            }
        if (!factorised && !factorise(r.normal, count, row)) return false;
        factorised = false;
        solve(r.normal, count, row, r.move);
        more = false;
        for (int i = 0; i < 2; ++i)
            if (!firm[i] && leaves(r, lit, lit + 1 + i, end + i)) more = firm[i] = true;
        if (more) draw_normal(s, r, lit, count);
    }
    return true;
}

// One step of all unknowns, if its linear model promises as much as STILL (nats). False: not positive. `promised`: by
// the step before, then by this one; `pace`: of both.
static bool step(const Scene s, const Room r, const int lit, const int count, const int row, double *promised,
    double *pace)
{
    for (int k = 0; k < count; ++k) r.pull[k] = r.move[k];
    bool firm[2];
    if (!held_step(s, r, lit, count, row, false, firm)) return false;
    const double before = *promised;
    double turned = 0.0;
    *promised = 0.0;
    for (int k = 0; k < count; ++k) *promised += 0.5 * r.pull[k] * r.move[k];
    if (fabs(*promised) < STILL) return true;
    for (int k = 0; before > 0.0 && k < count; ++k) turned += 0.5 * r.pull[k] * r.last[k];
    *pace = paced(*pace, before, turned);
    for (int k = 0; k < count; ++k) {
        const double by = *pace * r.move[k];
        r.value[k] += k <= lit ? clamp(by, -LONGEST_STEP, LONGEST_STEP) : by;
        r.last[k] = r.move[k];
    }
    r.value[lit + 1] = max(r.value[lit + 1], 0.0);
    r.value[lit + 2] = clamp(r.value[lit + 2], 0.0, 1.0);
    return true;
}

// A plane as the camera leaves it, zero where else `around` is.
static void draw_blurred(const Scene s, const Room r, __global const float *plane, const Box box, const Box around,
    const int apart, __global const float *weights, __global const int *radii, __global const float *taps,
    __global float *out)
{
    clear(out, around, s.side);
    for (int c = 0; c < s.components; ++c) {
        sweep(plane, apart, box, s.side, weights[c], taps, taps, radii[c], r.between, s.length, out);
        taps += 2 * radii[c] + 1;
    }
}

// Notes where a picture reaches at all.
static void note_reach(const Scene s, const Room r, const int slot, const Box box)
{
    const float least = min(LEAST_LIT, FAINT * sqrt(s.sigma2) * exp(-s.gain));
    __global uint *reach = r.products.reach + slot * (s.side / LANES);
    for (int column = 0; column < s.side; column += LANES) {
        const bool in = box.left <= column && column < box.right;
        reach[column / LANES] = in ? reach_of(picture_in(s, r, slot), box, s.side, column, least) : 0;
    }
}

static float most_in(__global const float *picture, const Box box, const int side)
{
    floats most = 0.0f;
    for (int row = box.top; row < box.bottom; ++row)
        most = fmax(most, most_in_row(picture + row * side, box.left, box.right));
    return most_of(most);
}

// Of one work-item, whatever the poses: the sky's pictures, and scales that never change.
static void prepare(const Scene s, const Room r, __global const float *slopes)
{
    const Box all = {0, s.side, 0, s.side};
    for (int k = 0; k < 3; ++k) {
        clear(picture_in(s, r, SKY + k), all, s.side);
        add(picture_in(s, r, SKY + k), slopes + k * s.pixels, all, s.side, 1.0f);
    }
    for (int slot = 0; slot < EVEN; ++slot) {
        r.box[slot] = all;
        for (int k = 0; k < s.side / LANES; ++k) r.products.reach[slot * (s.side / LANES) + k] = ~0u;
    }
}

// The pictures of a drawn pose that do not change with its light: how many positives are lit, and their `plane`.
static int draw_pictures(const Scene s, const Room r, __global const float *planes, const Box cut,
    __global const float *weights, __global const int *radii, __global const float *taps, const int groups, Box *body)
{
    const int tall = tile_rows(s.first), apart = cut.right - cut.left, each = (cut.bottom - cut.top) * apart;
    int radius = 0, lit = 0;
    for (int c = 0; c < s.components; ++c) radius = max(radius, radii[c]);
    planes -= cut.top * apart + cut.left;  // so that places are those of the patch
    __global const float *covered = planes + groups * each;
    const Box cover = box_of(covered, cut, apart, 0.0f, r.between);
    *body = cover;
    if (cover.top < cover.bottom) *body = in_units(widened(cover, radius + (s.speckle ? 4 : 1), s.side), s.side);
    for (int slot = EVEN; slot < s.first; ++slot) {
        r.box[slot] = *body;
        for (int column = 0; column < s.side; column += LANES)
            r.products.reach[(slot * s.side + column) / LANES]
                = body->left <= column && column < body->right ? units_of(s.side, body->top, body->bottom) : 0;
    }
    for (int k = 0; k < EVEN_PLANES; ++k)
        draw_blurred(s, r, covered + k * each, cover, *body, apart, weights, radii, taps, picture_in(s, r, EVEN + k));
    for (int p = 0; p < s.positives; ++p) {
        __global const float *plane = planes + (p < groups ? p : p + EVEN_PLANES) * each;
        const Box box = box_of(plane, cover, apart, LEAST_LIT, r.between);
        if (box.top >= box.bottom) continue;
        const int slot = s.first + lit;
        const Box wide = widened(box, radius, s.side);
        Box tiles = in_units(common(wide, *body), s.side);  // which reach it are read whole
        tiles.top = max(tiles.top - tall, body->top);
        tiles.bottom = min(tiles.bottom + tall, body->bottom);
        draw_blurred(s, r, plane, box, tiles, apart, weights, radii, taps, picture_in(s, r, slot));
        if (most_in(picture_in(s, r, slot), wide, s.side) <= LEAST_LIT) continue;
        r.box[slot] = wide;
        note_reach(s, r, slot, wide);
        r.plane[lit++] = p;
    }
    return lit;
}

// Priors and first values of the unknowns: `start`, or where there is none the prior's and the gain that fits best with
// it.
static void begin(const Scene s, const Room r, const int lit, const Box body, __global const float *offset,
    const Facets f, __global const float *start, __global const float *data)
{
    const Box all = {0, s.side, 0, s.side};
    for (int m = 0; m < lit; ++m) {
        r.mean[m] = (double)f.mean[r.plane[m]];
        r.precision[m] = (double)f.precision[r.plane[m]];
    }
    tie_facets(f, r.plane, lit, r.precision, r.mean, r.tie, r.kin);
    for (int m = 0; m < lit; ++m) r.value[m] = start ? (double)start[r.plane[m]] : r.mean[m];
    for (int k = s.positives; k < s.unknowns; ++k) {
        r.mean[lit + k - s.positives] = (double)f.mean[k];
        r.precision[lit + k - s.positives] = (double)f.precision[k];
        r.value[lit + k - s.positives] = (double)(start ? start[k] : f.mean[k]);
    }
    for (int k = 0; k < lit + s.unknowns - s.positives; ++k) r.scale[k] = 1.0f;
    if (s.speckle) {
        const float factorial[5] = {1, 1, 2, 6, 24};
        int m = lit + 9;
        for (int order = 2; order <= 4; ++order)
            for (int b = 0; b <= order; ++b)
                r.scale[m++] = pown(s.width, order) / sqrt(factorial[order - b] * factorial[b]);
    }
    clear(r.light, all, s.side);  // beyond the body, too
    if (start) return;
    // The gain by least squares, everything else at its prior.
    for (int m = 0; m < lit; ++m)
        add(r.light, picture_in(s, r, s.first + m), r.box[s.first + m], s.side,
            exp(offset[r.plane[m]] + (float)r.mean[m]));
    add(r.light, picture_in(s, r, EVEN), body, s.side, (float)r.mean[lit + 1]);
    const float power = dot_in(r.light, r.light, body, s.side), likeness = dot_in(r.light, data, body, s.side);
    if (power > 0.0f && likeness > 0.0f)
        r.value[lit] = (double)clamp(log(likeness / power), s.gain - 4.0f, s.gain + 4.0f);
}

// Sum of log t of the residuals, and the mean square of those on the body over their scale. Of a pixel of which a least
// value is known all that is more is as likely: it has t over its height, and no part in the mean.
static double log_density(const Scene s, const Room r, __global const uchar *marks, float *chi2)
{
    const double density = lgamma(0.5 * (NU + 1.0)) - lgamma(0.5 * NU) - 0.5 * log(NU * M_PI);
    __global const float *residuals = picture_in(s, r, RESIDUAL);
    floats misfit = 0.0f, body = 0.0f, told = 0.0f;
    double total = 0.0;
    for (int row = 0; row < s.side; ++row) {
        floats sum = 0.0f;
        for (int k = row * s.side; k < (row + 1) * s.side; k += LANES) {
            const floats residual = floats_at(residuals + k), variance = floats_at(r.variance + k);
            const floats light = floats_at(r.light + k), part = residual * residual / variance;
            const ints known = (convert_int16(vload16(0, marks + k)) & 1) == 0;
            sum += (known ? 0.5f * log(variance) : 0.0f) + loss_of(residual, variance);
            told += known ? 1.0f : 0.0f;
            const ints on = (light * light > s.sigma2 / s.area) & known;
            misfit += on ? part : 0.0f;
            body += on ? 1.0f : 0.0f;
        }
        total -= (double)sum_of(sum);
    }
    *chi2 = sum_of(body) > 0.0f ? sum_of(misfit) / sum_of(body) : 0.0f;
    return total + density * sum_of(told);
}

// Where the unknowns are, in the order in which they are given; dark planes' where they are expected.
static void tell_values(const Scene s, const Room r, const int lit, const Facets f, __global float *out)
{
    tell_facets(f, r.plane, lit, r.value, out);
    for (int k = s.positives; k < s.unknowns; ++k) out[k] = (float)r.value[lit + k - s.positives];
}

// How many numbers `tell` writes.
static size_t told_size(const Scene s)
{
    return LANES + (size_t)(4 + s.unknowns) * s.pixels + (size_t)s.unknowns * (s.unknowns + 4);
}

// For Gauss-Newton: curvature and slope of the log posterior by the unknowns, before the factor takes their place.
static void tell_normal(const Scene s, const Room r, const int count, const int row, __global float *out)
{
    __global float *to = out + LANES + (4 + s.unknowns) * s.pixels + 2 * s.unknowns;
    for (int i = 0; i < count; ++i) {
        for (int j = 0; j < count; ++j) to[i * count + j] = (float)r.normal[i * row + j];
        to[s.unknowns * s.unknowns + i] = (float)r.move[i];
    }
}

// The same of unknowns that a step would take beyond their ends: a pose near by does not move them, either.
static void tell_firm(const Scene s, const int lit, const int count, const bool *firm, __global float *out)
{
    __global float *to = out + LANES + (4 + s.unknowns) * s.pixels + 2 * s.unknowns;
    for (int i = 0, k = lit + 1; i < 2; ++i, ++k)
        if (firm[i]) {
            to[k * count + k] *= (float)FIRM;
            to[s.unknowns * s.unknowns + k] = 0.0f;
        }
}

// For Gauss-Newton: count, and the box in which pictures are told; residual, weight, model, light; then in that box
// every scaled picture; precision, deviation; last of all the numbers of the planes that are lit.
static void tell(const Scene s, const Room r, const int lit, const int count, const Box body, __global float *out)
{
    __global float *to = out + LANES;
    __global const float *residual = picture_in(s, r, RESIDUAL);
    const int wide = max(body.right - body.left, 0), tall = max(body.bottom - body.top, 0);
    out[0] = count;
    out[1] = body.top;
    out[2] = body.top + tall;
    out[3] = body.left;
    out[4] = body.left + wide;
    for (int k = 0; k < s.pixels; k += LANES) {
        const floats root = floats_at(r.root + k);
        put(to + k, floats_at(residual + k));
        put(to + s.pixels + k, root * root);
        put(to + 2 * s.pixels + k, floats_at(r.model + k));
        put(to + 3 * s.pixels + k, floats_at(r.light + k));
    }
    to += 4 * s.pixels;
    __global float *picked = to;
    for (int i = 0; i < count; ++i) {
        __global const float *picture = i == lit ? r.light : picture_in(s, r, slot_of(s, lit, i));
        const Box box = i == lit ? body : r.box[slot_of(s, lit, i)];
        for (int row = body.top; row < body.bottom; ++row, picked += wide)
            for (int column = body.left; column < body.right; column += LANES) {
                const bool in = row >= box.top && row < box.bottom && column >= box.left && column < box.right;
                const int k = row * s.side + column;
                floats column_of = in ? r.scale[i] * floats_at(picture + k) : (floats)0.0f;
                for (int m = lit + 6; i == lit && m < lit + 9; ++m)  // of the light, what grows with the gain
                    column_of -= r.scale[m] * (float)r.value[m] * floats_at(picture_in(s, r, TILT + m - lit - 6) + k);
                put(picked + column - body.left, column_of);
            }
    }
    to += s.unknowns * s.pixels;
    for (int i = 0; i < count; ++i) {
        to[i] = (float)r.precision[i];
        to[s.unknowns + i] = (float)(r.value[i] - r.mean[i]);
    }
    to += s.unknowns * (s.unknowns + 3);
    for (int m = 0; m < lit; ++m) to[m] = (float)r.plane[m];
}

// given_mean, given_precision (unknowns), or `every` of them a pose; given_start (N, unknowns) if `started`. pieces
// (positives), ties (2, positives): `own` and `common` of Facets. marks: 1 where a pixel is known from below alone,
// added to twice the number of a piece that may be a star's; stars (n_stars, 5): of each its number, rows and columns.
// spreads (N, 4): of each pose its first component, how many they are, its first tap, and which of the drawn ones it
// is. own (N, 4): C tau^2, width of the point spread, variance per count, light of the sky that a body can hide.
// out (N, 4): log evidence, chi2 of the body, log det, squared deviation; coefficients (N, planes) what `combined`
// takes; values (N, unknowns) where they ended.
__kernel void evidence(
    __global const float *planes, const int poses, __global const float *offset, __global const float *given_mean,
    __global const float *given_precision, const int every, __global const float *given_start, const int started,
    __global const int *pieces, __global const float *ties, __global const float *data, __global const uchar *marks,
    __global const float *slopes, __global const float *bumps, __global const float *weights, __global const int *radii,
    __global const float *taps, __global const int *stars, const int groups, const int side, const int n_planes,
    const int speckle, const int shifts, const int rounds, const int top, const int left, const int rows,
    const int columns, const int length, const int n_stars, const float sigma2, const float area, const float edge2,
    const float gain, const float star,
    __global const int *spreads, __global const float *own, __global float *out,
    __global float *coefficients, __global float *values, __global float *details, __global float *memory,
    const ulong each, volatile __global int *next)
{
    const int more = (speckle ? HERMITE : 0) + (shifts ? 2 * BUMPS : 0), pixels = side * side;
    const int positives = n_planes - EVEN_PLANES;
    Scene s = {side, pixels, pixels + ODD * LANES, n_planes, positives, positives + 9 + more, speckle, shifts, rounds,
        0, SPECKLE + more, length, n_stars, sigma2, 0.0f, 0.0f, area, 0.0f, edge2, 0.0f, gain, star};
    const Room r = room_in(memory + get_global_id(0) * each, s);
    prepare(s, r, slopes);
    const Box cut = {top, top + rows, left, left + columns};
    __global const float *behind = slopes + 3 * pixels;  // light of the sky at a place, over its level
    Box body = {0, 0, 0, 0};
    int lit = 0, drawn = -1, blurred = -1;
    for (int pose = atomic_inc(next); pose < poses; pose = atomic_inc(next)) {
        __global const int *spread = spreads + 4 * pose;
        s.components = spread[1];
        s.wrong = own[4 * pose];
        s.width = own[4 * pose + 1];
        s.photon = own[4 * pose + 2];
        s.hidden = own[4 * pose + 3];
        // Under another discrepancy, or with other paint, the same pose has the same pictures.
        if (spread[3] != drawn || spread[0] != blurred)
            lit = draw_pictures(s, r, planes + (size_t)spread[3] * n_planes * rows * columns, cut,
                weights + spread[0], radii + spread[0], taps + spread[2], groups, &body);
        drawn = spread[3];
        blurred = spread[0];
        const Facets f = facets_of(positives, pieces, ties, given_mean + (size_t)pose * every,
            given_precision + (size_t)pose * every);
        begin(s, r, lit, body, offset, f, started ? given_start + (size_t)pose * s.unknowns : 0, data);
        const int count = lit + s.unknowns - s.positives, row = (count + EIGHT - 1) & -EIGHT;
        float gained = draw_model(s, r, lit, count, body, offset, data, marks, behind, bumps, stars);
        bool sound = true, still = false;
        double promised = 0.0, pace = 1.0;
        for (int round = 0; round < rounds && sound && !still; ++round) {
            products(r.products, s.first + lit, body, r.total);
            draw_normal(s, r, lit, count);
            sound = step(s, r, lit, count, row, &promised, &pace);
            still = fabs(promised) < STILL;
            if (!still) gained = draw_model(s, r, lit, count, body, offset, data, marks, behind, bumps, stars);
        }
        if (!still) products(r.products, s.first + lit, body, r.total);
        draw_normal(s, r, lit, count);
        if (details) tell_normal(s, r, count, row, details + pose * told_size(s));
        sound = factorise(r.normal, count, row);
        const double2 tied = tied_of(lit, r.value, r.mean, r.precision, r.tie, r.kin);
        double logdet = -tied.x, squares = tied.y;
        for (int i = 0; i < count; ++i) {
            logdet += 2.0 * log(r.normal[i * row + i]) - log(r.precision[i]);
            squares += r.precision[i] * (r.value[i] - r.mean[i]) * (r.value[i] - r.mean[i]);
        }
        float chi2;
        const double value = log_density(s, r, marks, &chi2) / area + gained - 0.5 * squares - 0.5 * logdet;
        out[4 * pose] = sound ? (float)value : -INFINITY;
        out[4 * pose + 1] = chi2;
        out[4 * pose + 2] = (float)logdet;
        out[4 * pose + 3] = (float)squares;
        __global float *told = coefficients + (size_t)pose * n_planes, *ended = values + (size_t)pose * s.unknowns;
        const float bright = (float)exp(r.value[lit]);
        tell_values(s, r, lit, f, ended);
        for (int p = 0; p < s.positives; ++p)
            told[p < groups ? p : p + EVEN_PLANES] = bright * exp(offset[p] + ended[p]);
        for (int m = 0; m < lit; ++m) told[r.plane[m] < groups ? r.plane[m] : r.plane[m] + EVEN_PLANES] = r.scale[m];
        told[groups] = bright * (float)r.value[lit + 1] - s.hidden * (float)r.value[lit + 2];
        for (int k = 0; k < 3; ++k) told[groups + 1 + k] = r.scale[lit + 6 + k] * (float)r.value[lit + 6 + k];
        if (details) {
            bool firm[2];
            held_step(s, r, lit, count, row, sound, firm);
            tell_firm(s, lit, count, firm, details + pose * told_size(s));
            tell(s, r, lit, count, body, details + pose * told_size(s));
        }
    }
}
