// From scores to weights, and the sums that the estimate (Eq. 5) is made of.
//
// Every work-item adds up its share of the particles; then the work-items' parts are added up. The order is fixed, so
// the same device gives the same bits.
//
// Built with (gpu/step.py): GROUP, JOINTS; needs step_rotation.cl and step_motion.cl before it.

static bool comes_first(const long score, const int particle, const long other_score, const int other)
{
    return score > other_score || (score == other_score && particle < other);
}

// The best score of each group's particles, and the first particle that has it.
__kernel void find_best(__global const long *scores, const int n, __global long *best_scores, __global int *best)
{
    __local long score[GROUP];
    __local int particle[GROUP];
    const int me = get_local_id(0);
    score[me] = LONG_MIN;
    particle[me] = n;
    for (int i = get_global_id(0); i < n; i += get_global_size(0))
        if (scores[i] > score[me]) {
            score[me] = scores[i];
            particle[me] = i;
        }
    for (int half_group = GROUP / 2; half_group > 0; half_group /= 2) {
        barrier(CLK_LOCAL_MEM_FENCE);
        const int other = me + half_group;
        if (me < half_group && comes_first(score[other], particle[other], score[me], particle[me])) {
            score[me] = score[other];
            particle[me] = particle[other];
        }
    }
    if (me == 0) {
        best_scores[get_group_id(0)] = score[0];
        best[get_group_id(0)] = particle[0];
    }
}

// Log weights relative to the heaviest. Scores are whole numbers, so nothing is lost when the best is subtracted.
__kernel void weigh(
    __global const long *scores, const int n, const long best_score, const float nats, __global float *log_weights)
{
    const int i = get_global_id(0);
    if (i < n) log_weights[i] = nats * (float)(scores[i] - best_score);
}

// Row k of `parts` holds a part of sum k from each work-item of another kernel; one work-group per row adds it up.
__kernel void add_parts(__global const float *parts, const int items, __global float *sums)
{
    __local float terms[GROUP];
    const int me = get_local_id(0), row = get_group_id(0);
    float term = 0.0f;
    for (int item = me; item < items; item += GROUP) term += parts[row * items + item];
    terms[me] = term;
    for (int half_group = GROUP / 2; half_group > 0; half_group /= 2) {
        barrier(CLK_LOCAL_MEM_FENCE);
        if (me < half_group) terms[me] += terms[me + half_group];
    }
    if (me == 0) sums[row] = terms[0];
}

static void write_column(__global float *parts, const float *sum, const int rows)
{
    for (int k = 0; k < rows; ++k) parts[k * get_global_size(0) + get_global_id(0)] = sum[k];
}

// w, w^2, then w times: x, y, scale; each joint's value, cosine and sine; the ten products of the quaternion with
// itself (x x, x y, x z, x w, y y, ...).
#define MEAN_SUMS (5 + 3 * JOINTS + 10)

__kernel void sums_for_mean(
    __global const float4 *rotations, __global const float *values, __global const float *log_weights, const int n,
    __global float *parts)
{
    float sum[MEAN_SUMS];
    for (int k = 0; k < MEAN_SUMS; ++k) sum[k] = 0.0f;
    for (int i = get_global_id(0); i < n; i += get_global_size(0)) {
        const float w = exp(log_weights[i]);
        sum[0] += w;
        sum[1] += w * w;
        sum[2] += w * values[i];
        sum[3] += w * values[n + i];
        sum[4] += w * exp(values[2 * n + i]);
        int k = 5;
        for (int joint = 0; joint < JOINTS; ++joint) {
            const float value = values[(3 + joint) * n + i], angle = value / 180.0f;    // in half turns
            sum[k++] += w * value;
            sum[k++] += w * cospi(angle);
            sum[k++] += w * sinpi(angle);
        }
        float q[4];
        vstore4(rotations[i], 0, q);
        for (int a = 0; a < 4; ++a)
            for (int b = a; b < 4; ++b) sum[k++] += w * q[a] * q[b];
    }
    write_column(parts, sum, MEAN_SUMS);
}

// w times the rotation vector from the mean rotation: zero where the mean is Karcher's.
__kernel void sums_for_rotation(
    __global const float4 *rotations, __global const float *log_weights, const int n, __global const float *mean,
    __global float *parts)
{
    const float4 back = inverse(vload4(0, mean));
    float3 sum = (float3)(0.0f);
    for (int i = get_global_id(0); i < n; i += get_global_size(0))
        sum += exp(log_weights[i]) * rotation_vector(multiply(back, rotations[i]));
    float separate[3];
    vstore3(sum, 0, separate);
    write_column(parts, separate, 3);
}

// w times: the products of the tangent coordinates about `mean` (its quaternion, then its values) with each other
// (0 0, 0 1, ..., 1 1, ...); the squared difference of the scales.
#define SPREAD_SUMS (TANGENT * (TANGENT + 1) / 2 + 1)

__kernel void sums_for_spread(
    __global const float4 *rotations, __global const float *values, __global const float *log_weights, const int n,
    __global const float *mean, __global const float *period, __global float *parts)
{
    const float4 back = inverse(vload4(0, mean));
    __global const float *mean_values = mean + 4;
    const float mean_scale = exp(mean_values[2]);
    float sum[SPREAD_SUMS];
    for (int k = 0; k < SPREAD_SUMS; ++k) sum[k] = 0.0f;
    for (int i = get_global_id(0); i < n; i += get_global_size(0)) {
        const float w = exp(log_weights[i]);
        float t[TANGENT];
        vstore3(rotation_vector(multiply(back, rotations[i])), 0, t);
        for (int k = 0; k < VALUES; ++k) {
            const float apart = values[k * n + i] - mean_values[k];
            t[3 + k] = period[k] > 0.0f ? apart - period[k] * rint(apart / period[k]) : apart;    // the short way round
        }
        int k = 0;
        for (int a = 0; a < TANGENT; ++a)
            for (int b = a; b < TANGENT; ++b) sum[k++] += w * t[a] * t[b];
        const float scale_apart = exp(values[2 * n + i]) - mean_scale;
        sum[k] += w * scale_apart * scale_apart;
    }
    write_column(parts, sum, SPREAD_SUMS);
}
