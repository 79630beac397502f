// The prior of facets: paint of one piece is alike, so what its facets have in common is integrated out. Of both forms
// of the evidence; the readable twin is service/inference/model/facets.py.

// Of all positives. Those of one piece follow each other.
typedef struct {
    int positives;
    __global const int *piece;
    __global const float *own, *common;  // precision about what a piece has in common, 0 if a plane is alone; of that
    __global const float *mean, *precision;  // of each about it: `own`, and what was learnt
} Facets;

static Facets facets_of(const int positives, __global const int *piece, __global const float *ties,
    __global const float *mean, __global const float *precision)
{
    const Facets f = {positives, piece, ties, ties + positives, mean, precision};
    return f;
}

// Precision and pull of what the piece that begins with plane `p` has in common, by its prior and its dark facets.
// `m`: the first lit plane that is not before it, then the first beyond it; `end`: the plane after its last.
static double2 said_of(const Facets f, const int p, __global const int *plane, const int lit, int *m, int *end)
{
    double2 said = (double2)((double)f.common[p], 0.0);
    for (*end = p; *end < f.positives && f.piece[*end] == f.piece[p]; ++*end) {
        const double own = f.own[*end];
        if (*m < lit && plane[*m] == *end) ++*m;
        else said += (double2)(own - own * own / (double)f.precision[*end], own * (double)f.mean[*end]);
    }
    return said;
}

// Means of lit planes by all that is known of their pieces, from means about what they have in common; `tie`: what
// that takes from the precision of each with each of its piece; `kin`: the first lit one of its piece.
static void tie_facets(const Facets f, __global const int *plane, const int lit, __global const double *precision,
    __global double *mean, __global double *tie, __global int *kin)
{
    int m = 0;
    for (int p = 0, end; p < f.positives; p = end) {
        const int first = m;
        const double2 said = said_of(f, p, plane, lit, &m, &end);
        const double own = f.own[p], whole = said.x + (m - first) * own, by = own > 0.0 ? own / whole : 0.0;
        double means = 0.0, variances = 0.0;
        for (int k = first; k < m; ++k) {
            kin[k] = first;
            tie[k] = own * by;
            mean[k] += by * said.y / precision[k];
            means += mean[k];
            variances += 1.0 / precision[k];
        }
        const double more = own * by * means / (1.0 - own * by * variances);
        for (int k = first; k < m; ++k) mean[k] += more / precision[k];
    }
}

// Of all positives where they are: lit ones' values, and what those and priors say of dark ones.
static void tell_facets(const Facets f, __global const int *plane, const int lit, __global const double *value,
    __global float *out)
{
    int m = 0;
    for (int p = 0, end; p < f.positives; p = end) {
        const int first = m;
        const double2 said = said_of(f, p, plane, lit, &m, &end);
        const double own = f.own[p];
        double sum = said.y;
        for (int k = first; k < m; ++k) sum += own * value[k];
        const double common = own > 0.0 ? sum / (said.x + (m - first) * own) : 0.0;
        for (int q = p; q < end; ++q) out[q] = (float)((double)f.mean[q] + own * common / (double)f.precision[q]);
        for (int k = first; k < m; ++k) out[plane[k]] = (float)value[k];
    }
}

// What ties add to the log determinant of the prior's precision, and to the squared deviation from its means.
static double2 tied_of(const int lit, __global const double *value, __global const double *mean,
    __global const double *precision, __global const double *tie, __global const int *kin)
{
    double2 more = 0.0;
    for (int first = 0, k = 0; first < lit; first = k) {
        double away = 0.0, variances = 0.0;
        for (; k < lit && kin[k] == first; ++k) {
            away += value[k] - mean[k];
            variances += 1.0 / precision[k];
        }
        more += (double2)(log(1.0 - tie[first] * variances), -tie[first] * away * away);
    }
    return more;
}
