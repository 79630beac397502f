// The sum of a map under N silhouettes, by their outlines. One work-item takes particle after particle.
// Built with: PARTS, WIDTH, HEIGHT, MAPS, WORDS (of 64 columns, width + 1 in all).
#pragma OPENCL FP_CONTRACT OFF

static int sign_of(float v) { return (v > 0.0f) - (v < 0.0f); }

static float3 project(__global const float *t, float x, float y, float z)
{
    return (float3)(((x * t[0] + y * t[1]) + z * t[2]) + t[3], ((x * t[4] + y * t[5]) + z * t[6]) + t[7], 0.0f);
}

// First row (or column) whose centre is not before v.
static int first_centre(float v, int limit) { return clamp((int)ceil(v - 0.5f), 0, limit); }

static void draw_edge(float2 a, float2 b, int winding, __global short *diff, __global ulong *marks)
{
    if (a.y > b.y) { float2 swap = a; a = b; b = swap; winding = -winding; }
    const int top = first_centre(clamp(a.y, -1.0f, HEIGHT + 1.0f), HEIGHT);
    const int bottom = first_centre(clamp(b.y, -1.0f, HEIGHT + 1.0f), HEIGHT);
    if (top >= bottom) return;
    const float slope = (b.x - a.x) / (b.y - a.y);
    for (int row = top; row < bottom; ++row) {
        const float x = a.x + (((float)row + 0.5f) - a.y) * slope;
        const int column = first_centre(clamp(x, -1.0f, WIDTH + 1.0f), WIDTH);
        diff[row * (WORDS * 64) + column] += winding;
        marks[row * WORDS + (column >> 6)] |= 1ul << (column & 63);
    }
}

static long sum_row(__global const int *prefix, __global short *diff, __global ulong *marks)
{
    long total = 0;
    int winding = 0;
    for (int word = 0; word < WORDS; ++word) {
        ulong bits = marks[word];
        marks[word] = 0;
        while (bits) {
            const int column = word * 64 + (63 - clz(bits & -bits));
            bits &= bits - 1;
            const int before = winding;
            winding += diff[column];
            diff[column] = 0;
            if ((before == 0) != (winding == 0)) total += before ? prefix[column] : -prefix[column];
        }
    }
    return total;
}

__kernel void score(
    __global const float *transforms, const int particles, __global const int *edge_start,
    __global const float *edges, const int n_edges, __global const int *prefix,
    __global long *scores, __global short *all_diff, __global ulong *all_marks, volatile __global int *next)
{
    __global short *diff = all_diff + get_global_id(0) * (size_t)(HEIGHT * WORDS * 64);
    __global ulong *marks = all_marks + get_global_id(0) * (size_t)(HEIGHT * WORDS);
    for (int n = atomic_inc(next); n < particles; n = atomic_inc(next)) {
        for (int part = 0; part < PARTS; ++part) {
            __global const float *t = transforms + ((size_t)n * PARTS + part) * 12;
            const float3 view = cross((float3)(t[0], t[1], t[2]), (float3)(t[4], t[5], t[6]));
            for (int e = edge_start[part]; e < edge_start[part + 1]; ++e) {
                __global const float *v = edges + e;
                const int s = sign_of(v[6 * n_edges] * view.x + v[7 * n_edges] * view.y + v[8 * n_edges] * view.z)
                    - sign_of(v[9 * n_edges] * view.x + v[10 * n_edges] * view.y + v[11 * n_edges] * view.z);
                if (s == 0) continue;
                draw_edge(project(t, v[0], v[n_edges], v[2 * n_edges]).xy,
                    project(t, v[3 * n_edges], v[4 * n_edges], v[5 * n_edges]).xy, s, diff, marks);
            }
        }
        long total[MAPS];
        for (int k = 0; k < MAPS; ++k) total[k] = 0;
        for (int row = 0; row < HEIGHT; ++row)
            total[0] += sum_row(prefix + row * (WIDTH + 1), diff + row * (WORDS * 64), marks + row * WORDS);
        scores[n] = total[0];
    }
}
