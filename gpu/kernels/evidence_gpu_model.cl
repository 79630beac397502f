// The model of a frame, of evidence_gpu_room.cl: launches of an item a pixel. A pose that goes no further keeps what it
// has.

// The light that all pictures make together.
__kernel GROUPS void light(ASKED)
{
    SCENE
    if (!r.told[GOING]) return;
    const int k = get_global_id(0), lit = r.told[LIT];
    float light = 0.0f;
    if (within(box_at(r, BODY), k / s.side, k % s.side)) {
        for (int m = 0; m < lit; ++m) light = fma(r.scale[m], positive_in(s, r, m)[k], light);
        light = fma(r.scale[lit + 1] * (float)r.value[lit + 1], picture_in(s, r, EVEN)[k], light);
        for (int m = 0; m < 3; ++m)
            light = fma(r.scale[lit + 6 + m] * (float)r.value[lit + 6 + m], picture_in(s, r, TILT + m)[k], light);
    }
    r.light[k] = light;
}

// Central differences in a box beyond which the picture is zero; zero at the borders of the patch.
static float slope_across(__global const float *picture, const Box box, const int side, const int row, const int column)
{
    if (column == 0 || column == side - 1) return 0.0f;
    __global const float *at = picture + row * side + column;
    return 0.5f * ((column + 1 < box.right ? at[1] : 0.0f) - (column > box.left ? at[-1] : 0.0f));
}

static float slope_down(__global const float *picture, const Box box, const int side, const int row, const int column)
{
    if (row == 0 || row == side - 1) return 0.0f;
    __global const float *at = picture + row * side + column;
    return 0.5f * ((row + 1 < box.bottom ? at[side] : 0.0f) - (row > box.top ? at[-side] : 0.0f));
}

__kernel GROUPS void slopes(ASKED)
{
    SCENE
    const int k = get_global_id(0);
    const Box body = box_at(r, BODY);
    if (!r.told[GOING] || !within(body, k / s.side, k % s.side)) return;
    r.across[k] = slope_across(r.light, body, s.side, k / s.side, k % s.side);
    r.down[k] = slope_down(r.light, body, s.side, k / s.side, k % s.side);
}

// Gauss-Hermite deviations of the point spread of one order, each from one an order lower: an item a pixel of each.
__kernel GROUPS void speckle(ASKED, const int order)
{
    SCENE
    const int b = (int)get_global_id(0) / s.pixels, k = (int)get_global_id(0) % s.pixels;
    const int row = k / s.side, column = k % s.side;
    const Box body = box_at(r, BODY);
    if (!r.told[GOING] || !within(body, row, column)) return;
    const int slot = SPECKLE + (order - 2) * (order + 3) / 2 + b, before = slot - order - (b > 0);
    __global const float *from = order > 2 ? picture_in(s, r, before) : b < 2 ? r.across : r.down;
    picture_in(s, r, slot)[k] = b == 0 ? slope_across(from, body, s.side, row, column)
                                       : slope_down(from, body, s.side, row, column);
}

// Pictures of the image's shifts, model, residual, weight.
__kernel GROUPS void model(ASKED, __global const float *data, __global const uchar *marks, __global const float *sky,
    __global const float *bumps)
{
    SCENE
    if (!r.told[GOING]) return;
    const int k = get_global_id(0), lit = r.told[LIT], deviations = s.speckle ? HERMITE : 0;
    const float light = r.light[k];
    float model = light, variance = s.sigma2 / s.area;
    for (int m = 0; m < 3; ++m) model = fma((float)r.value[lit + 3 + m], sky[m * s.pixels + k], model);
    if (within(box_at(r, BODY), k / s.side, k % s.side)) {
        const float dx = r.across[k], dy = r.down[k];
        variance += s.photon / s.area * fmax(light, 0.0f) + s.wrong * (light * light + s.edge2 * (dx * dx + dy * dy));
        const float hidden = r.scale[lit + 2] * (float)r.value[lit + 2] * sky[3 * s.pixels + k];
        model = fma(hidden, picture_in(s, r, EVEN)[k], model);
        for (int m = 0; m < deviations; ++m)
            model = fma(r.scale[lit + 9 + m] * (float)r.value[lit + 9 + m], picture_in(s, r, SPECKLE + m)[k], model);
        for (int b = 0; s.shifts && b < 2 * BUMPS; ++b) {
            const float shifted = bumps[b % BUMPS * s.pixels + k] * (b < BUMPS ? dx : dy);
            picture_in(s, r, SPECKLE + deviations + b)[k] = shifted;
            model = fma((float)r.value[lit + 9 + deviations + b], shifted, model);
        }
    }
    float residual = data[k] - model;
    const bool censored = marks[k] & 1;
    if (censored && residual < 0.0f) residual = 0.0f;
    float weight = ((NU + 1.0f) / s.area) / (NU * variance + residual * residual);
    if (censored) weight *= fmin(residual / sqrt(variance), 1.0f);  // more is no contradiction, and tells nothing
    r.model[k] = model;
    picture_in(s, r, RESIDUAL)[k] = residual;
    r.variance[k] = variance;
    r.root[k] = sqrt(weight);
}

// Log of what a pixel loses by its residual.
static float loss_of(const float residual, const float variance)
{
    return 0.5f * (NU + 1.0f) * log(1.0f + residual * residual / (NU * variance));
}

// Light that may be a star's, see weigh_stars of evidence.cl: a group a piece. No pixel is of two pieces.
__kernel GROUPS void stars(ASKED, __global const uchar *marks, __global const int *boxes)
{
    __local double8 sums[GROUP];
    SCENE
    const int going = r.told[GOING], piece = get_group_id(0), number = boxes[5 * piece];
    const Box box = {boxes[5 * piece + 1], boxes[5 * piece + 2], boxes[5 * piece + 3], boxes[5 * piece + 4]};
    __global const float *residuals = picture_in(s, r, RESIDUAL);
    double8 lost = 0.0;
    FOR_OWN(own, going ? area_of(box) : 0) {
        const int k = pixel_of(box, s.side, own);
        if (marks[k] >> 1 == number && residuals[k] > 0.0f) lost.s0 += (double)loss_of(residuals[k], r.variance[k]);
    }
    const float better = (float)sum_of_all(sums, lost).s0 / s.area - s.star;
    const float root = sqrt(1.0f / (1.0f + exp(better)));  // of the share that it is the body's
    FOR_OWN(own, going ? area_of(box) : 0) {
        const int k = pixel_of(box, s.side, own);
        if (marks[k] >> 1 == number && residuals[k] > 0.0f) r.root[k] *= root;
    }
    if (going && ITEM == 0) r.gained[piece] = better > 0.0f ? better + log1p(exp(-better)) : log1p(exp(better));
}
