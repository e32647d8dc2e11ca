// How the arrays that the kernels share are laid out (built by csrc/precompute).
//
// Nodes stand in blocks: TLED_LANES neighbours in one plane of z, TLED_WIDTH along x by TLED_HEIGHT
// along y, lane = x + TLED_WIDTH y. The element whose low corner is lane l of a block is lane l of that
// block. Reals of a block are stored together, one row of lanes a quantity, so the row r of block b of
// an array with n rows begins at (b n + r) TLED_LANES. One empty block stands behind the last; links
// that lead nowhere lead there.

// Lanes along x of a block of vector rows, which has as many as a quarter of a register of AVX-512, that
// a lane is moved within, and of whose shape sheets and limbs fill most. Work-items of one lane have all
// lanes along x, so that neighbours in memory are neighbours in x.
#define TLED_ROW_WIDTH 4
#define TLED_WIDTH_OF(vector_rows, lanes) \
  ((vector_rows) && (lanes) > TLED_ROW_WIDTH ? TLED_ROW_WIDTH : (lanes))
#define TLED_WIDTH TLED_WIDTH_OF(TLED_VECTOR_ROWS, TLED_LANES)
#define TLED_HEIGHT (TLED_LANES / TLED_WIDTH)

// blocks[TLED_BLOCK_INTS * block + ...]: links of one block.
#define TLED_BLOCK_INTS 16
#define BLOCK_NEXT_X 0        // the block behind in x
#define BLOCK_NEXT_Y 1        // the block behind in y; the one behind in z is always block + 1
#define BLOCK_MATERIAL 2      // its row set in `materials`, -1: no element here
#define BLOCK_NODE 3          // its row set in `node_sets`
#define BLOCK_MUSCLE_BEGIN 4  // its entries of `muscle_entries`
#define BLOCK_MUSCLE_END 5
#define BLOCK_PLANE 6         // z of the block, counted from the lowest
#define BLOCK_PREV_X 7
#define BLOCK_PREV_Y 8
#define BLOCK_PREV_Z 9
#define BLOCK_NEXT_Z 10
#define BLOCK_EDGE 11  // the place in `edge` of its y and z, its negative if no block is before it in x

#define BLOCK_LAW_BEGIN 12  // its entries of `law_entries`
#define BLOCK_LAW_END 13
#define BLOCK_NEXT_XY 14  // BLOCK_NEXT_X of BLOCK_NEXT_Y
// Subcycling: level of its nodes, of its elements and of the nodes of the block before in x, four
// bits each. What is on level l takes a step of 2^l of the shortest steps. Rows kernels only. The upper
// half has a bit for each lane with an element.
#define BLOCK_LEVELS 15
#define ELEMENT_BITS(levels) ((levels) & ~0xffff)
#define ELEMENT_BIT(lane) (16 + (lane))
#define HAS_ELEMENT(levels, lane) ((levels) >> ELEMENT_BIT(lane) & 1)
#define NODE_LEVEL(levels) ((levels) & 15)
#define ELEMENT_LEVEL(levels) ((levels) >> 4 & 15)
#define PREV_X_LEVEL(levels) ((levels) >> 8 & 15)

// materials: row sets of element parameters; blocks alike share one.
#define TLED_MATERIAL_ROWS 10
#define MATERIAL_MU 0              // Pa, of the neo-Hookean share
#define MATERIAL_BULK_LOG_HALF 1   // K/2 of U = K/4 (J^2 - 1 - 2 ln J)
#define MATERIAL_BULK_QUADRATIC 2  // K of U = K/2 (J - 1)^2
#define MATERIAL_NU 3
#define MATERIAL_BEND_X 4  // 16 V E'_b / 48, section normal to x; the kappa form's k is here too
#define MATERIAL_BEND_Y 5
#define MATERIAL_BEND_Z 6
#define MATERIAL_TWIST 7  // 16 V mu / 48
#define MATERIAL_XYZ 8    // 16 V E / 144
#define MATERIAL_KAPPA 4
#define MATERIAL_PRESENT 9  // 1: there is an element in this lane, 0: there is none

// law_entries[3 i]: law (its number in laws.cl), [3 i + 1]: first of its rows in `law_sets`,
// [3 i + 2]: first of its rows in the history, -1: it has none. In rows of lanes.
#define TLED_LAW_ENTRY 3

// node_sets: row sets of nodal constants; blocks alike share one.
#define TLED_NODE_ROWS 3  // 1/m per component, 1/kg; 0 where the component is fixed

// muscle_entries[2 i]: muscle, [2 i + 1]: its row set in `muscle_sets` for this block.
#define TLED_MUSCLE_ROWS 4     // fibre direction x, y, z; weight (0: no fibre in this lane)
#define TLED_MUSCLE_CONSTANTS 8  // reals a muscle, see muscle/tension_length.cl

// step_table[step * TLED_STEP_REALS(n) + ...]: what changes from step to step. The first five are
// there for each level of subcycling, TLED_STEP_LEVEL reals apart; d is dt of level 0.
#define STEP_VELOCITY 0  // (1 - a dt/2) / (1 + a dt/2), a the damping, dt of the level
#define STEP_FORCE 1     // d dt / (1 + a dt/2); half of it in the step that starts from rest
#define STEP_GRAVITY 2   // three: gravity times dt^2 / (1 + a dt/2)
#define STEP_DUE 5       // dt / d, the weight of forces where the level is due, else 0
#define STEP_DT 6        // s, of level 0; below 0: see LawState
#define STEP_TIME 7      // s, at the begin of the step
#define STEP_UNIT 5      // 1, the factor of loads that do not change: level 0 is always due
#define TLED_STEP_LEVEL 8
#define TLED_MOST_LEVELS 5
#define STEP_ACTIVATION 40  // and on: activation of each muscle, then conditions on nodes

// shape: constants of the voxel.
#define SHAPE_GRADIENT 0  // three: 1/(4 h_d)
#define SHAPE_FORCE 3     // three: V/(4 h_d)
#define SHAPE_RATIO_XY 6  // h_x/h_y, and so on
#define SHAPE_RATIO_YX 7
#define SHAPE_RATIO_YZ 8
#define SHAPE_RATIO_ZY 9
#define SHAPE_RATIO_ZX 10
#define SHAPE_RATIO_XZ 11
#define TLED_SHAPE_REALS 16

// A conforming mesh (hexahedra.cl): lane l of block b is an element and a node that have nothing to
// do with each other. hex_nodes[(block 8 + corner) TLED_LANES + lane]: the corner's x component in
// u. hex_rows[(block TLED_HEX_ROWS + row) TLED_LANES + lane]; csrc/precompute/hexahedron.hpp.
#define TLED_HEX_ROWS 55
#define HEX_GRADIENT 0  // 24: mean dN_a/dX_j at 3 a + j, 1/m
#define HEX_OFFSET 24   // 12: c_mj at 3 m + j; m: xy, yz, zx, xyz
#define HEX_AXES 36     // 9: axis d of the box over 4 h_d, at 3 d + j
#define HEX_SQUARE 45   // 3: 16 h_d^2
#define HEX_RATIO 48    // 6: h_x/h_y, and so on as SHAPE_RATIO
#define HEX_VOLUME 54   // m^3

// Rows of blocks that a band walks (rows.cl), by cells: one for each chunk in x and row in y, chunk by
// chunk. bands[2 i]: first cell of band i, bands[2 i + 1]: the one behind its last. rows[4 i]: first
// block, number of blocks, first row of sliding nodes and how many there are; row_begin[chunk * rows in
// y + y] the first of a cell, and one more behind the last.
#define TLED_RUN 4
#define RUN_BLOCK 0
#define RUN_BLOCKS 1
#define RUN_SLIDING 2
#define RUN_SLIDING_COUNT 3

// Rows of lanes a plane of scratch: forces x, y, z on the nodes one on in y, of the last lanes those of
// the next row of blocks, by the corners at low x, then by those at high x (the node one on in x).
#define SCRATCH_ROWS 6
// edge: what the last lanes in x of a block give the first of the block behind, forces x, y, z behind a
// real that is nothing, for each y of it. A place for each y and z, read by a block before it writes
// its own. Nothing is before the first place, and nothing but zero in TLED_NO_EDGE.
#define TLED_EDGE_REALS(width, lanes) (4 * (lanes) / (width))
#define TLED_NO_EDGE 1
#define TLED_FIRST_EDGE 2
// Reals of a band's scratch and edges. Between those of two bands lies a page or more: what a processor
// fetches ahead of one thread is not to be what another writes.
#define BAND_GAP 1024
#define SCRATCH_REALS(n_planes, lanes) ((n_planes) * (SCRATCH_ROWS * (lanes)) + BAND_GAP)
#define BAND_EDGE_REALS(n_edges, width, lanes) \
  ((n_edges) * TLED_EDGE_REALS(width, lanes) + BAND_GAP)

// Tiles of node columns that a work-group walks (tile.cl). tiles[TLED_TILE_INTS * tile + ...]; its
// places are, of each plane from the one below its first node to the one above its last, of each
// row from that of its first elements to the one behind its last, the blocks of
// TLED_TILE_BLOCKS chunks in x; the empty block where there is none.
#define TLED_TILE_INTS 5
#define TILE_PLACES 0  // first of its places
#define TILE_PLANES 1  // of nodes
#define TILE_LANE 2    // of its first elements, in the first of the chunks
#define TILE_CHUNK 3   // the first of the chunks; -1 where its first elements are before all nodes
#define TILE_FIRST 4   // 0; 1 where nothing is below its first plane of nodes, which it then begins with
#define TLED_TILE_BLOCKS(width, lanes) (((width) + (lanes) - 1) / (lanes) + 1)

// Reals that a work-item of tile.cl hands to others: forces on three corners.
#define TLED_TILE_HANDED 9

// state[(block TLED_STATE_ROWS + row) TLED_LANES + lane]: what element_state writes (state.cl).
#define TLED_STATE_ROWS 17
#define STATE_F 0           // nine: xx xy xz yx yy yz zx zy zz
#define STATE_SIGMA 9       // six: xx yy zz xy yz xz, Pa, muscles included
#define STATE_ENERGY 15     // W, J/m3
#define STATE_HOURGLASS 16  // J/m3

// What a look at the limit of the step asks with (step_bounds.cl).
#define LOOK_REACH 0       // lowest share of a fibre's stretch that is taken
#define LOOK_REACH_STEP 1  // and the way to the next
#define LOOK_THRESHOLD 2   // omega^2 from which the growth of nodes counts, 1/s^2
#define LOOK_ACTIVATION 3  // and on: of each muscle
