// Sixteen numbers at a time: what a CPU does with one instruction of AVX-512, two of AVX2, four of SSE or Neon.
#pragma OPENCL FP_CONTRACT OFF   // the reference rounds every product, so do we

#define LANES 16

typedef float16 floats;
typedef int16 ints;
typedef floats __attribute__((aligned(4))) loose_floats;
typedef ints __attribute__((aligned(4))) loose_ints;

// Sixteen values from any element of an array.
static floats floats_at(__global const float *from) { return *(__global const loose_floats *)from; }
static ints ints_at(__global const int *from) { return *(__global const loose_ints *)from; }

static ints lane_numbers(void) { return (ints)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15); }

// The first of the points 0, 1, 2, ... that is not before v, at most `end`.
static ints first_from(floats v, const int end)
{
    const floats last = (float)end;
    v = v > 0.0f ? v : 0.0f;
    v = v < last ? v : last;
    const ints whole = convert_int16_rtz(v);
    return whole - (v > convert_float16(whole));
}

// lanes_where(c): bit k is set where lane k of c is true (-1).
// append_where(c, values, list, count): write the chosen values to the end of a list, in order; returns its new length.
// Up to LANES elements behind the new end are overwritten.
#if defined(__AVX512F__) && defined(__AVX512DQ__) && defined(__has_builtin)
#if __has_builtin(__builtin_ia32_compresssi512_mask) && __has_builtin(__builtin_ia32_cvtd2mask512)
#define COMPRESS_IN_HARDWARE
#endif
#endif

#ifdef COMPRESS_IN_HARDWARE
typedef int native_ints __attribute__((vector_size(64)));

static uint lanes_where(ints chosen) { return __builtin_ia32_cvtd2mask512(__builtin_astype(chosen, native_ints)); }

static int append_where(ints chosen, ints values, __global int *list, int count)
{
    const uint lanes = lanes_where(chosen);
    const native_ints packed = __builtin_ia32_compresssi512_mask(
        __builtin_astype(values, native_ints), __builtin_astype((ints)0, native_ints), lanes);
    *(__global loose_ints *)(list + count) = __builtin_astype(packed, ints);
    return count + popcount(lanes);
}
#else
static uint lanes_where(ints chosen)
{
    const ints bits = chosen & ((ints)1 << lane_numbers());
    const int8 eight = bits.lo | bits.hi;
    const int4 four = eight.lo | eight.hi;
    const int2 two = four.lo | four.hi;
    return two.lo | two.hi;
}

static int append_where(ints chosen, ints values, __global int *list, int count)
{
    int wanted[LANES], value[LANES];
    vstore16(chosen, 0, wanted);
    vstore16(values, 0, value);
    for (int k = 0; k < LANES; ++k) {
        list[count] = value[k];
        count -= wanted[k];
    }
    return count;
}
#endif
