// Rotations as unit quaternions (x, y, z, w), and their rotation vectors.

static float4 multiply(const float4 a, const float4 b)
{
    const float3 v = a.w * b.xyz + b.w * a.xyz + cross(a.xyz, b.xyz);
    return normalize((float4)(v, a.w * b.w - dot(a.xyz, b.xyz)));
}

static float4 inverse(const float4 q) { return (float4)(-q.xyz, q.w); }

// A rotation vector in radians -> its quaternion.
static float4 turned_by(const float3 v)
{
    const float half_angle = 0.5f * length(v);
    const float ratio = half_angle > 1e-12f ? 0.5f * sin(half_angle) / half_angle : 0.5f;
    return (float4)(ratio * v, cos(half_angle));
}

// A quaternion -> its rotation vector, of length at most pi.
static float3 rotation_vector(const float4 q)
{
    const float4 near = q.w < 0.0f ? -q : q;
    const float sine = length(near.xyz);
    return (sine > 1e-12f ? 2.0f * atan2(sine, near.w) / sine : 2.0f) * near.xyz;
}

// Turn a point.
static float3 rotate(const float4 q, const float3 point)
{
    const float3 twice = 2.0f * cross(q.xyz, point);
    return point + q.w * twice + cross(q.xyz, twice);
}
