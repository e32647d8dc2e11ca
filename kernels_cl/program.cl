// Everything that is compiled for a device, in the order of use. The OpenCL backend joins these
// files as text; the native backend compiles the same text as C++ behind its shim.
//
// Defined by whoever compiles: TLED_OPENCL (0: C++ through the shim), TLED_LANES (nodes a block),
// TLED_VECTOR_ROWS (1: realv is a vector of a block's lanes, 0: one real, a work-item a lane),
// TLED_DOUBLE, and by the OpenCL backend TLED_LAWS (0: no block has law entries; GPUs then need not
// keep registers for the laws).
#ifndef TLED_LAWS
#define TLED_LAWS 1
#endif
#include "dialect.cl"
#include "elementary.cl"
#include "tensor.cl"
#include "layout.cl"
#include "kinematics.cl"
#include "base.cl"
#include "laws.cl"
#include "muscle/tension_length.cl"
#include "hourglass.cl"
#include "element.cl"
#include "node.cl"
#include "sliding_layout.cl"
#include "sliding_search.cl"
#include "sliding_zone.cl"
#include "sliding_region.cl"
#include "sliding_look.cl"
#include "sliding_plane.cl"
#include "sliding.cl"
#include "row_element.cl"
#if TLED_VECTOR_ROWS
#include "sliding_rows.cl"
#include "rows.cl"
#else
#include "sliding_still.cl"
#include "sliding_seek.cl"
#include "sliding_queue.cl"
#include "corner_modes.cl"
#include "gather.cl"
#include "tile.cl"
#endif
#include "hexahedra.cl"
#include "device_checks.cl"
#include "step_bounds.cl"
#if TLED_VECTOR_ROWS
#include "state.cl"
#endif
#include "conditions.cl"
