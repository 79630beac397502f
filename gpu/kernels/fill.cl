// The sum of a map under N silhouettes as the paper's CPU rows have it: fill every face, then go over the pixels.
//
// A pixel is one bit. Faces that look away are left out where the piece that they belong to is closed: the faces that
// look at the camera cover the same pixels. Coordinates are those of pixel centres: pixel (i, j) is the point (j, i).

typedef struct {
    __global float *x, *y;       // projected vertices of one part
    __global int *row;           // the first row whose centre is not above them
    __global int *filled;        // numbers of its faces that are to be filled
    __global ulong *bits;        // rows of `words`
    int width, height, words;
} Canvas;

static Canvas take_canvas(__global ulong *memory, const int most_vertices, const int width, const int height)
{
    Canvas c;
    c.width = width;
    c.height = height;
    c.words = width / 64 + 1;
    c.bits = memory;
    c.x = (__global float *)(memory + (size_t)height * c.words);
    c.y = c.x + most_vertices;
    c.row = (__global int *)(c.y + most_vertices);
    c.filled = c.row + most_vertices;
    for (int k = 0; k < height * c.words; ++k) c.bits[k] = 0;
    return c;
}

static int first_from_one(const float v, const int end)
{
    const float held = v > 0.0f ? (v < (float)end ? v : (float)end) : 0.0f;
    const int whole = (int)held;
    return whole + (held > (float)whole);
}

static void fill_span(__global ulong *row, const int from, const int to)
{
    if (from >= to) return;
    const int first = from >> 6, last = to >> 6;
    const ulong head = ~0ul << (from & 63), tail = ~(~0ul << (to & 63));
    if (first == last) {
        row[first] |= head & tail;
        return;
    }
    row[first] |= head;
    for (int word = first + 1; word < last; ++word) row[word] = ~0ul;
    row[last] |= tail;
}

static ints crossings_of(floats x, floats y, floats slope, ints row, const int width)
{
    return first_from(x + (convert_float16(row) - y) * slope, width);
}

typedef struct { float x, y, slope; } Side;   // upper end, pixels per row

static Side side_of(const Canvas c, const int upper, const int lower)
{
    Side s = {c.x[upper], c.y[upper], (c.x[lower] - c.x[upper]) / (c.y[lower] - c.y[upper])};
    return s;
}

// Does the face cross the centre of a row, and is it needed? Without branches: nobody could predict them.
static int is_filled(const Canvas c, const int4 face)
{
    const int p = face.x, q = face.y, r = face.z;
    const bool away = (c.x[q] - c.x[p]) * (c.y[r] - c.y[p]) <= (c.x[r] - c.x[p]) * (c.y[q] - c.y[p]);
    return ((c.row[p] != c.row[q]) | (c.row[q] != c.row[r])) & !(face.w & away);
}

static void fill_face(const Canvas c, const int4 face)
{
    int p = face.x, q = face.y, r = face.z;
    if (c.y[p] > c.y[q]) { const int swap = p; p = q; q = swap; }
    if (c.y[q] > c.y[r]) { const int swap = q; q = r; r = swap; }
    if (c.y[p] > c.y[q]) { const int swap = p; p = q; q = swap; }
    const Side whole = side_of(c, p, r), upper = side_of(c, p, q), lower = side_of(c, q, r);
    for (int top = c.row[p]; top < c.row[r]; top += LANES) {
        const ints row = top + lane_numbers(), above = row < c.row[q];
        const ints one = crossings_of((floats)whole.x, (floats)whole.y, (floats)whole.slope, row, c.width);
        const ints two = crossings_of(
            above ? upper.x : lower.x, above ? upper.y : lower.y, above ? upper.slope : lower.slope, row, c.width);
        int from[LANES], to[LANES];
        vstore16(min(one, two), 0, from);
        vstore16(max(one, two), 0, to);
        __global ulong *bits = c.bits + top * c.words;
        const int rows = min(LANES, c.row[r] - top);
        for (int k = 0; k < rows; ++k, bits += c.words) fill_span(bits, from[k], to[k]);
    }
}

// `vertices` (3, all), `faces` (all, 4): three vertices of the part, and whether the piece is closed.
static void fill_parts(
    const Canvas c, __global const float *transforms, const int parts, __global const float *vertices,
    __global const int *vertex_start, __global const int4 *faces, __global const int *face_start)
{
    const int all = vertex_start[parts];
    for (int part = 0; part < parts; ++part) {
        __global const float *t = transforms + part * 12;
        const float t0 = t[0], t1 = t[1], t2 = t[2], t3 = t[3] - 0.5f;
        const float t4 = t[4], t5 = t[5], t6 = t[6], t7 = t[7] - 0.5f;
        __global const float *v = vertices + vertex_start[part];
        const int n = vertex_start[part + 1] - vertex_start[part];
        for (int k = 0; k < n; ++k) {
            const float x = v[k], y = v[all + k], z = v[2 * all + k];
            c.x[k] = ((x * t0 + y * t1) + z * t2) + t3;
            c.y[k] = ((x * t4 + y * t5) + z * t6) + t7;
            c.row[k] = first_from_one(c.y[k], c.height);
        }
        int filled = 0;
        for (int f = face_start[part]; f < face_start[part + 1]; ++f) {
            c.filled[filled] = f;
            filled += is_filled(c, faces[f]);
        }
        for (int k = 0; k < filled; ++k) fill_face(c, faces[c.filled[k]]);
    }
}

// scores (N): the sum of the map, in whole units (height, 64 * words); one work-item takes particle after particle.
__kernel void score(
    __global const float *transforms, const int particles, const int parts, __global const float *vertices,
    __global const int *vertex_start, __global const int4 *faces, __global const int *face_start,
    const int most_vertices, __global const int *map, const int width, const int height, __global long *scores,
    __global ulong *memory, const int memory_each, volatile __global int *next)
{
    const Canvas c = take_canvas(memory + get_global_id(0) * (size_t)memory_each, most_vertices, width, height);
    const ints bit = (ints)1 << lane_numbers();
    for (int n = atomic_inc(next); n < particles; n = atomic_inc(next)) {
        fill_parts(c, transforms + (size_t)n * parts * 12, parts, vertices, vertex_start, faces, face_start);
        long total = 0;
        for (int row = 0; row < height; ++row) {
            ints sum = 0;
            for (int word = 0; word < c.words; ++word) {
                ulong bits = c.bits[row * c.words + word];
                if (bits == 0) continue;
                c.bits[row * c.words + word] = 0;
                __global const int *values = map + (row * c.words + word) * 64;
                for (int k = 0; k < 64; k += LANES, bits >>= LANES)
                    sum += ((ints)(int)(bits & 0xffff) & bit) != 0 ? ints_at(values + k) : 0;
            }
            const long8 eight = convert_long8(sum.lo) + convert_long8(sum.hi);
            const long4 four = eight.lo + eight.hi;
            total += four.x + four.y + four.z + four.w;
        }
        scores[n] = total;
    }
}

// masks (N, height, width): one byte per pixel, 1 where it is covered.
__kernel void draw(
    __global const float *transforms, const int particles, const int parts, __global const float *vertices,
    __global const int *vertex_start, __global const int4 *faces, __global const int *face_start,
    const int most_vertices, const int width, const int height, __global uchar *masks, __global ulong *memory,
    const int memory_each, volatile __global int *next)
{
    const Canvas c = take_canvas(memory + get_global_id(0) * (size_t)memory_each, most_vertices, width, height);
    for (int n = atomic_inc(next); n < particles; n = atomic_inc(next)) {
        fill_parts(c, transforms + (size_t)n * parts * 12, parts, vertices, vertex_start, faces, face_start);
        for (int row = 0; row < height; ++row) {
            __global uchar *out = masks + ((size_t)n * height + row) * width;
            for (int column = 0; column < width; ++column)
                out[column] = c.bits[row * c.words + (column >> 6)] >> (column & 63) & 1;
            for (int word = 0; word < c.words; ++word) c.bits[row * c.words + word] = 0;
        }
    }
}
