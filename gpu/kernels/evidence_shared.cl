// What both forms of the evidence take for granted: of evidence.cl, and of evidence_gpu_room.cl.

#define NU 4.0f
#define HERMITE 12
#define BUMPS 9
#define LEAST_LIT 1e-4f
#define LONGEST_STEP 1.5
#define FIRM 1e8  // times the curvature of an unknown that is to go nowhere else
#define STILL 1e-2  // nats: a step that promises less is not worth another look, and is not taken

// Slots of pictures. Many unknowns are one picture times a number: even light and hidden sky share theirs, that of the
// gain is the sum of what it brightens. Residuals stand among them because a pull is a product with the residual.
#define SKY 0
#define RESIDUAL 3
#define EVEN 4
#define TILT 5  // (3) normals: even light comes more from one side than from the other (EVEN_PLANES: with EVEN)
#define SPECKLE 8
