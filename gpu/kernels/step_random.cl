// Random numbers without a state: Philox4x32-10 of Salmon, Moraes, Dror and Shaw, "Parallel random numbers: as easy as
// 1, 2, 3" (SC 2011). The same counter and key give the same four numbers on every device, in any order.

static uint4 philox(uint4 counter, uint2 key)
{
    for (int round = 0; round < 10; ++round) {
        const uint high_x = mul_hi(0xD2511F53u, counter.x), low_x = 0xD2511F53u * counter.x;
        const uint high_z = mul_hi(0xCD9E8D57u, counter.z), low_z = 0xCD9E8D57u * counter.z;
        counter = (uint4)(high_z ^ counter.y ^ key.x, low_z, high_x ^ counter.w ^ key.y, low_x);
        key += (uint2)(0x9E3779B9u, 0xBB67AE85u);
    }
    return counter;
}

enum { FOR_RESAMPLING, FOR_MOTION };

// The four numbers of one particle's draw: no two particles, draws, purposes, frames or seeds share a counter and key.
static uint4 draw(const ulong seed, const uint frame, const uint purpose, const uint particle, const uint which)
{
    return philox((uint4)(particle, which, frame, purpose), as_uint2(seed));
}

// Four independent standard normal numbers (Box and Muller 1958).
static float4 normals(const uint4 bits)
{
    const float4 uniform = (convert_float4(bits) + 0.5f) * 0x1p-32f;    // in (0, 1]
    const float2 radius = sqrt(-2.0f * log(uniform.xy)), turn = 2.0f * uniform.zw;
    return (float4)(radius * cospi(turn), radius * sinpi(turn));
}
