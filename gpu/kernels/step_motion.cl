// From the particles that were drawn to where their silhouettes are.
//
// A particle is a rotation and VALUES numbers: x, y (px), log scale, then JOINTS joint values. Numbers of one kind lie
// next to each other: values[k * n + i] is the k-th of particle i.
//
// Built with (gpu/step.py): JOINTS, PARTS, STAGES.

#define VALUES (3 + JOINTS)
#define TANGENT (6 + JOINTS)

// Move each drawn particle by a Gaussian step in its tangent space. A step out of the prior's bounds is not made; a
// value with a period (a joint that turns all the way round) is brought back into its range instead.
__kernel void propagate(
    __global const float4 *rotations, __global const float *values, __global const int *ancestors, const int n,
    __global const float *deviation, __global const float *low, __global const float *high,
    __global const float *period, const ulong seed, const uint frame,
    __global float4 *moved_rotations, __global float *moved_values)
{
    const int i = get_global_id(0);
    if (i >= n) return;
    float step[(TANGENT + 3) / 4 * 4];
    for (int k = 0; k < TANGENT; k += 4) vstore4(normals(draw(seed, frame, FOR_MOTION, i, k / 4)), k / 4, step);
    for (int k = 0; k < TANGENT; ++k) step[k] *= deviation[k];

    const int from = ancestors[i];
    const float4 before = rotations[from], after = multiply(before, turned_by((float3)(step[0], step[1], step[2])));
    float moved[VALUES];
    bool inside = true;
    for (int k = 0; k < VALUES; ++k) {
        moved[k] = values[k * n + from] + step[3 + k];
        if (period[k] > 0.0f)
            moved[k] -= period[k] * floor((moved[k] - low[k]) / period[k]);
        else
            inside = inside && moved[k] >= low[k] && moved[k] <= high[k];
    }
    moved_rotations[i] = inside ? after : before;
    for (int k = 0; k < VALUES; ++k) moved_values[k * n + i] = inside ? moved[k] : values[k * n + from];
}

// One motion of some parts, about an axis (`slides` 0) or along it, fixed in the body frame at rest. It follows joint
// number `joint`, or stays at `held` where that is negative.
typedef struct {
    float axis[3], origin[3], held;
    int slides, joint;
} Stage;

// A rigid motion: turn, then shift.
typedef struct {
    float4 turn;
    float3 shift;
} Rigid;

static Rigid motion_of(const Stage stage, const float value)
{
    const float3 axis = vload3(0, stage.axis), origin = vload3(0, stage.origin);
    Rigid motion = {(float4)(0.0f, 0.0f, 0.0f, 1.0f), value * axis};
    if (!stage.slides) {
        motion.turn = turned_by(radians(value) * axis);
        motion.shift = origin - rotate(motion.turn, origin);
    }
    return motion;
}

// Where each part of the particles from `first` on goes: three rows (x px, y px, depth px) of four per part. The joints
// move a body point at rest, deepest stage first; then the camera (weak perspective) does: scale R X + (x, y, 0).
__kernel void part_transforms(
    __global const float4 *rotations, __global const float *values, const int n, const int first, const int count,
    __constant Stage *stages, __global const int *moves, __global float4 *transforms)
{
    const int i = get_global_id(0) / PARTS, part = get_global_id(0) % PARTS, particle = first + i;
    if (i >= count) return;
    Rigid motion = {(float4)(0.0f, 0.0f, 0.0f, 1.0f), (float3)(0.0f)};
    for (int s = 0; s < STAGES; ++s) {
        if (!moves[s * PARTS + part]) continue;
        const Stage stage = stages[s];
        const Rigid next = motion_of(stage, stage.joint < 0 ? stage.held : values[(3 + stage.joint) * n + particle]);
        motion.turn = multiply(next.turn, motion.turn);
        motion.shift = rotate(next.turn, motion.shift) + next.shift;
    }
    const float4 camera = rotations[particle], turn = multiply(camera, motion.turn);
    const float scale = exp(values[2 * n + particle]);
    const float3 x = scale * rotate(turn, (float3)(1.0f, 0.0f, 0.0f));
    const float3 y = scale * rotate(turn, (float3)(0.0f, 1.0f, 0.0f));
    const float3 z = scale * rotate(turn, (float3)(0.0f, 0.0f, 1.0f));
    const float3 place = scale * rotate(camera, motion.shift) + (float3)(values[particle], values[n + particle], 0.0f);
    __global float4 *rows = transforms + 3 * (i * PARTS + part);
    rows[0] = (float4)(x.x, y.x, z.x, place.x);
    rows[1] = (float4)(x.y, y.y, z.y, place.y);
    rows[2] = (float4)(x.z, y.z, z.z, place.z);
}
