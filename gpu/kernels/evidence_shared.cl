// What both forms of the evidence take for granted: of evidence.cl, and of evidence_gpu_room.cl.

#pragma OPENCL EXTENSION cl_khr_fp64 : enable

#define NU 4.0f
#define HERMITE 12
#define BUMPS 9
#define LEAST_LIT 1e-4f
#define LONGEST_STEP 1.5
#define FIRM 1e8  // times the curvature of an unknown that is to go nowhere else
#define SLOWEST 0.4  // share of a step that is taken: a cycle turns back by more than a whole one
#define FASTEST 2.0
#define STILL 1e-2  // nats: a step that promises less is not worth another look, and is not taken

// Slots of pictures. Many unknowns are one picture times a number: even light and hidden sky share theirs, that of the
// gain is the sum of what it brightens. Residuals stand among them because a pull is a product with the residual.
#define SKY 0
#define RESIDUAL 3
#define EVEN 4
#define TILT 5  // (3) normals: even light comes more from one side than from the other (EVEN_PLANES: with EVEN)
#define SPECKLE 8

// How far the next step goes. Weights that follow the model overshoot along some unknowns, where steps turn back, and
// creep along others: as far as the last two say together (Aitken). `promised`: by the last step, `turned`: by as much
// of it at the slope that it has led to; nats.
static double paced(const double pace, const double promised, const double turned)
{
    return promised > 0.0 ? clamp(pace / max(1.0 - turned / promised, 0.5 * SLOWEST), SLOWEST, FASTEST) : pace;
}
