// Arrays of sliding nodes and their surfaces (csrc/sim/sliding, csrc/broad_phase, sliding.cl).
//
// Rows of lanes: slide_rows[(row of nodes * SLIDE_ROWS + row) * TLED_LANES + lane].
#define SLIDE_ROWS 15
#define SLIDE_ANCHOR 0    // 3: displacement when level 2 was last run, m
#define SLIDE_RADIUS 3    // squared, m^2; 0: level 2 every step
#define SLIDE_NORMAL 4    // 3: unit normal of the plane
#define SLIDE_ALONG 7     // 3: way back for each metre off the plane; the normal where all may move
#define SLIDE_OFFSET 10   // distance from the plane = normal . u - offset, m
#define SLIDE_DISTANCE 11  // to keep, m, negative behind the surface
#define SLIDE_PLACE 12    // 3: reference position

// slide_ints[(row of nodes * SLIDE_INTS + k) * TLED_LANES + lane]
#define SLIDE_INTS 3
#define SLIDE_DOF 0      // of the x component in u; the empty block's in lanes without a node
#define SLIDE_SURFACE 1  // -1: no node here
#define SLIDE_FREE 2     // bits: 1 x may move, 2 y, 4 z

// Per node: candidates[node * SLIDE_CANDIDATES + ...], number first; candidate_reals[node * 4 + ...]:
// position when level 3 was last run, and the radius within which they are enough.
#define SLIDE_MOST 24
#define SLIDE_CANDIDATES (SLIDE_MOST + 1)

// triangles[triangle * TRIANGLE_REALS + ...]
#define TRIANGLE_REALS 30
#define TRIANGLE_CORNERS 0  // 9
#define TRIANGLE_NORMAL 9   // 3: face
#define TRIANGLE_EDGES 12   // 9: pseudonormals of edges 0-1, 1-2, 2-0
#define TRIANGLE_VERTICES 21  // 9

// grids[surface * GRID_INTS + ...], grid_reals[surface * GRID_REALS + ...]
#define GRID_INTS 4  // cells along x, y, z; first of its entries of cell_begin
#define GRID_REALS 4  // low corner, edge of a cell
