// Steps and what is told of a pose, of evidence_gpu_room.cl: launches of a group a pose.

// How many numbers `tell` writes.
static size_t told_size(const Scene s)
{
    return 16 + (size_t)(4 + s.unknowns) * s.pixels + (size_t)s.unknowns * (s.unknowns + 4);
}

// One step of all unknowns, if its linear model promises as much as STILL (nats). `last`: none is taken, the curvature
// alone is told. `matrix`: of the group, or where it is __global, of all poses of the launch.
__kernel GROUPS void move(ASKED, __global const float *offset, __global float *details, MATRIX double *matrix,
    const int apart, const int last)
{
    SCENE
    MATRIX double *a = matrix + get_global_id(1) * (size_t)apart;
    const int going = r.told[GOING] || last, lit = r.told[LIT], count = lit + s.unknowns - s.positives;
    if (going) {
        double promised = 0.0, turned = 0.0;
        Ends ends = {{false, false}, {0.0, 0.0}};
        const bool sound = held_step(s, r, lit, count, a, &ends, last,
            last && details ? details + s.pose * told_size(s) : 0);
        for (int k = 0; k < count; ++k) promised += 0.5 * r.pull[k] * a[cell(count, k, count)];
        for (int k = 0; r.paces[1] > 0.0 && k < count; ++k) turned += 0.5 * r.pull[k] * r.last[k];
        const double pace = paced(r.paces[0], r.paces[1], turned);
        const bool steps = sound && !last && !(fabs(promised) < STILL);
        TOGETHER  // before values change that others may still look at
        if (ITEM == 0) {
            r.told[GOING] = steps;
            r.told[SOUND] = sound;
            for (int k = 0; k < 2; ++k) r.told[FIRMLY + k] = ends.firm[k];
            r.paces[0] = pace;
            r.paces[1] = promised;
        }
        FOR_OWN(k, steps ? count : 0) {
            const double by = pace * a[cell(count, k, count)];
            double there = r.value[k] + (k <= lit ? clamp(by, -LONGEST_STEP, LONGEST_STEP) : by);
            if (k == lit + 1) there = max(there, 0.0);
            if (k == lit + 2) there = clamp(there, 0.0, 1.0);
            r.value[k] = there;
            r.last[k] = a[cell(count, k, count)];
        }
        TOGETHER
        if (steps) draw_scales(s, r, lit, offset);
    }
}

// Curvature and slope of unknowns that a step would take beyond their ends: a pose near by does not move them, either.
static void tell_firm(const Scene s, const Room r, const int lit, const int count, __global float *out)
{
    __global float *to = out + 16 + (4 + s.unknowns) * s.pixels + 2 * s.unknowns;
    for (int i = 0, k = lit + 1; i < 2 && ITEM == 0; ++i, ++k)
        if (r.told[FIRMLY + i]) {
            to[k * count + k] *= (float)FIRM;
            to[s.unknowns * s.unknowns + k] = 0.0f;
        }
}

// For Gauss-Newton, in the order of tell of evidence.cl.
static void tell_pictures(const Scene s, const Room r, const int lit, const int count, const Box body,
    __global const float *sky, __global float *out)
{
    const int told[5] = {count, body.top, body.bottom, body.left, body.right};
    for (int k = 0; k < 5 && ITEM == 0; ++k) out[k] = told[k];
    __global float *to = out + 16;
    FOR_OWN(k, s.pixels) {
        to[k] = picture_in(s, r, RESIDUAL)[k];
        to[s.pixels + k] = r.root[k] * r.root[k];
        to[2 * s.pixels + k] = r.model[k];
        to[3 * s.pixels + k] = r.light[k];
    }
    to += 4 * s.pixels;
    for (int i = 0; i < count; ++i)
        FOR_OWN(own, area_of(body)) {
            const int k = pixel_of(body, s.side, own);
            float seen = i == lit ? r.light[k] : r.scale[i] * seen_in(s, r, sky, slot_of(s, lit, i))[k];
            for (int m = lit + 6; i == lit && m < lit + 9; ++m)  // of the light, what grows with the gain
                seen -= r.scale[m] * (float)r.value[m] * picture_in(s, r, TILT + m - lit - 6)[k];
            to[i * area_of(body) + own] = seen;
        }
    to += s.unknowns * s.pixels;
    FOR_OWN(i, count) {
        to[i] = (float)r.precision[i];
        to[s.unknowns + i] = (float)(r.value[i] - r.mean[i]);
    }
    to += s.unknowns * (s.unknowns + 3);
    FOR_OWN(m, lit) to[m] = (float)r.plane[m];
}

// What `combined` draws the same light with, and where the unknowns are; dark planes' where they are expected.
static void tell_values(const Scene s, const Room r, const int lit, const Facets f, __global const float *offset,
    __global float *drawn, __global float *values)
{
    const float bright = (float)exp(r.value[lit]);
    if (ITEM == 0) tell_facets(f, r.plane, lit, r.value, values);
    TOGETHER
    FOR_OWN(p, s.positives) drawn[p < s.groups ? p : p + EVEN_PLANES] = bright * exp(offset[p] + values[p]);
    for (int k = s.positives + ITEM; k < s.unknowns; k += GROUP) values[k] = (float)r.value[lit + k - s.positives];
    FOR_OWN(k, 4)
        drawn[s.groups + k] = k ? r.scale[lit + 5 + k] * (float)r.value[lit + 5 + k]
            : bright * (float)r.value[lit + 1] - s.hidden * (float)r.value[lit + 2];
}

// Evidence, chi2 of the body, log det, squared deviation: a group a pose. See log_density of evidence.cl.
__kernel GROUPS void finish(ASKED, __global const uchar *marks, __global float *out)
{
    __local double8 sums[GROUP];
    SCENE
    __global const float *residuals = picture_in(s, r, RESIDUAL);
    float lost = 0.0f, misfit = 0.0f, on = 0.0f, told = 0.0f;
    FOR_OWN(k, s.pixels) {
        const bool known = !(marks[k] & 1);
        lost += (known ? 0.5f * log(r.variance[k]) : 0.0f) + loss_of(residuals[k], r.variance[k]);
        told += known ? 1.0f : 0.0f;
        if (known && r.light[k] * r.light[k] > s.sigma2 / s.area) {
            misfit += residuals[k] * residuals[k] / r.variance[k];
            on += 1.0f;
        }
    }
    double squares = 0.0, logs = 0.0;
    FOR_OWN(i, r.told[LIT] + s.unknowns - s.positives) {
        squares += r.precision[i] * (r.value[i] - r.mean[i]) * (r.value[i] - r.mean[i]);
        logs += r.logs[i];
    }
    if (ITEM == 0) {
        const double2 tied = tied_of(r.told[LIT], r.value, r.mean, r.precision, r.tie, r.kin);
        logs -= tied.x;
        squares += tied.y;
    }
    const double8 all
        = sum_of_all(sums, (double8)((double)lost, (double)misfit, (double)on, squares, logs, (double)told, 0.0, 0.0));
    if (ITEM == 0) {
        const double density = lgamma(0.5 * (NU + 1.0)) - lgamma(0.5 * NU) - 0.5 * log(NU * M_PI);
        float gained = 0.0f;
        for (int piece = 0; piece < s.stars; ++piece) gained += r.gained[piece];
        const double value = (density * all.s5 - all.s0) / s.area + gained - 0.5 * all.s3 - 0.5 * all.s4;
        __global float *to = out + 4 * (size_t)s.pose;
        to[0] = r.told[SOUND] ? (float)value : -INFINITY;
        to[1] = all.s2 > 0.0 ? (float)(all.s1 / all.s2) : 0.0f;
        to[2] = (float)all.s4;
        to[3] = (float)all.s3;
    }
}

// What is told beside the evidence: see evidence of evidence.cl.
__kernel GROUPS void tell(ASKED, __global const float *given_mean, __global const float *given_precision,
    __global const int *pieces, __global const float *ties, __global const float *offset, __global const float *sky,
    __global float *coefficients, __global float *values, __global float *details)
{
    SCENE
    const int lit = r.told[LIT], count = lit + s.unknowns - s.positives;
    const Facets f = facets_of(s.positives, pieces, ties, given_mean + (size_t)s.pose * s.every,
        given_precision + (size_t)s.pose * s.every);
    tell_values(s, r, lit, f, offset, coefficients + (size_t)s.pose * s.planes, values + (size_t)s.pose * s.unknowns);
    if (details) {
        __global float *to = details + s.pose * told_size(s);
        tell_firm(s, r, lit, count, to);
        tell_pictures(s, r, lit, count, box_at(r, BODY), sky, to);
    }
}
