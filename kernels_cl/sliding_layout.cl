// Arrays of sliding nodes and their surfaces (csrc/sim/sliding, csrc/broad_phase, sliding.cl).
//
// Rows of lanes: slide_rows[(row of nodes * SLIDE_ROWS + row) * TLED_LANES + lane], what every step
// reads, and slide_regions, likewise, the rest. Displacements are those seen from the surface
// (sliding.cl).
#define SLIDE_ROWS 8
#define SLIDE_SEEN 0      // 3: displacement amid a ball in which nothing changes, m
#define SLIDE_SLACK 3     // radius of the ball, m; 0: to be looked at
#define SLIDE_NORMAL 4    // 3: unit normal of the plane; of an edge its direction, of a corner 0
#define SLIDE_TARGET 7    // plane: normal . u at the distance to keep, m; edge, corner: that distance

#define REGION_ROWS 12
#define REGION_ALONG 0     // 3: way back for each metre off the distance, where the row has held lanes;
                           // after a step that keeps them everywhere
#define REGION_LOSS 3      // what friction took so far, J for each kg of the node
#define REGION_ROUND 4     // 0 plane; edge, corner: 1 before the surface, -1 behind
#define REGION_ON 5        // 3: edge, corner: a point of it less the reference position, m
#define REGION_DISTANCE 8  // to keep, m, negative behind the surface
#define REGION_PLACE 9     // 3: reference position

// slide_records[node * RECORD_REALS + ...]: what a look at one node reads, in single precision a line of the
// cache: looks lie so far apart that each finds its page unknown, and more lines would be on more pages.
#define RECORD_REALS 16
#define RECORD_PLACE 0     // 3: as REGION_PLACE
#define RECORD_DISTANCE 3  // as REGION_DISTANCE
#define RECORD_NEXT 4      // zone behind the border of its zone that it is nearest to, as ZONE_MORE; -1: none
#define RECORD_EXIT 5      // 4: that border
#define RECORD_ANCHOR 9    // 3: displacement when level 3 was last run, m
#define RECORD_RADIUS 12   // of the region's ball, m
#define RECORD_ZONE 13     // where it was last, as ZONE_MORE; -1: in none, the region is its own
#define RECORD_SURFACE 14  // 8 times the surface and bits: 1 x may move, 2 y, 4 z; -1: no node here

// slide_heads[row of nodes * SLIDE_HEAD + ...], where rows are vectors; behind the last SLIDE_AHEAD of
// nothing, for those who look ahead.
#define SLIDE_AHEAD 24
#define SLIDE_HEAD 2
#define HEAD_BLOCK 0  // whose nodes they are
#define HEAD_SHAPE 1  // as SLIDE_SHAPE

// slide_ints[(row of nodes * SLIDE_INTS + k) * TLED_LANES + lane]. Where rows are vectors, or a tile
// puts nodes back, the nodes of a row are those of one block, lane by lane.
#define SLIDE_INTS 2
#define SLIDE_DOF 0      // of the x component in u
#define SLIDE_SHAPE 1    // where rows are no vectors, bits: 1 a lane is held, 2 << l lane l on edge or corner

// slide_queue, where rows are no vectors: how many nodes wait for a look in a step to the first of the two
// displacement buffers and in one to the second, then their places, row of nodes * TLED_LANES + lane.
#define SLIDE_WAITING 2

// slide_laws[(row of nodes * SLIDE_LAWS + k) * TLED_LANES + lane], where surfaces move, rub or let go
#define SLIDE_LAWS 5
#define SLIDE_FRICTION 0  // coefficient
#define SLIDE_RELEASE 1   // 1: may leave the surface
#define SLIDE_MAY 2       // 3: 1 where the component may move, else 0

// Poses of a moving surface in the step table, at the begin and at the end of the step: rotation, row
// by row, and translation, x = rotation . X + translation.
#define POSE_REALS 12

// Per node: candidates[node * SLIDE_CANDIDATES + ...], number first, by distance when level 4 was last
// run; candidate_reals[node * SLIDE_CANDIDATE_REALS + ...]: position then, the radius within which
// they are enough, their distances, and of the node's own region unit normals of borders, outward, and
// limits, m.
#define SLIDE_MOST 20
#define SLIDE_CANDIDATES (SLIDE_MOST + 1)
#define CANDIDATE_BORDERS (SLIDE_MOST + 4)
#define REGION_MOST_BORDERS 4
#define SLIDE_CANDIDATE_REALS (CANDIDATE_BORDERS + 4 * REGION_MOST_BORDERS)

// triangles[triangle * TRIANGLE_REALS + ...]
#define TRIANGLE_REALS 34
#define TRIANGLE_CORNERS 0  // 9
#define TRIANGLE_NORMAL 9   // 3: face
#define TRIANGLE_EDGES 12   // 9: pseudonormals of edges 0-1, 1-2, 2-0
#define TRIANGLE_VERTICES 21  // 9
#define TRIANGLE_BALL 30    // 4: a ball that holds it: centre, radius

// zones[zone * ZONE_UNIT + ...] (sliding_zone.cl): as many units as its borders need; and triangle_zones[triangle * TRIANGLE_ZONES + ...]:
// of nodes before it the face's, those of edges 0-1, 1-2, 2-0 and of corners, then of nodes behind it; -1: none.
#define ZONE_UNIT 16
#define ZONE_COUNT 0      // of borders
#define ZONE_ROUND 1      // as REGION_ROUND
#define ZONE_ON 2         // 3: a corner of the face, an end of the edge, the corner
#define ZONE_DIRECTION 5  // 3: normal of the face, direction of the edge, of a corner 0
#define ZONE_BORDERS 8    // groups of ZONE_GROUP borders, each of ZONE_BORDER_REALS rows:
#define ZONE_BORDER_REALS 5  // unit normal, outward; limit, m; the zone behind, as ZONE_MORE, -1: none is known
#define ZONE_GROUP 8
// Where a zone is named by a real that is its number and so much more it has more than one group of borders, so
// that all of it can be fetched before any of it is there.
#define ZONE_MORE 0.5
#define ZONE_GROUP_REALS (ZONE_GROUP * ZONE_BORDER_REALS)
#define ZONE_MOST_BORDERS 16
// Where the first real of border k stands; the others follow ZONE_GROUP apart. Places of a group without
// border have a limit that nothing comes near.
#define ZONE_BORDER_AT(k) (ZONE_BORDERS + (k) / ZONE_GROUP * ZONE_GROUP_REALS + (k) % ZONE_GROUP)
#define TRIANGLE_ZONES 14

// grids[surface * GRID_INTS + ...], grid_reals[surface * GRID_REALS + ...]
#define GRID_INTS 4  // cells along x, y, z; first of its entries of cell_begin
#define GRID_REALS 4  // low corner, edge of a cell
