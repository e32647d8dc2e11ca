// Compiled once per instruction set and precision (cmake/NativeKernels.cmake) with
// TLED_TABLE (the function's name), TLED_INSTRUCTION_SET, TLED_LANES and TLED_DOUBLE; once more
// with TLED_COUNTED, where a row counts what is done with it.
#include "backend/native/kernel_table.hpp"

#if TLED_COUNTED
#include "backend/native/counted.hpp"
#else
#include "backend/native/shim.hpp"
#endif

#if defined(__SSE__)
#include <xmmintrin.h>
#endif

namespace {
#include "program.cl"
#include "roofline.cl"

using tledface::native::KernelArg;
using tledface::native::KernelEntry;

template <class T>
struct Argument {
  static constexpr bool kIsPointer = false;
  static T get(const KernelArg& arg) { return arg.integer; }
};
template <class T>
struct Argument<T*> {
  static constexpr bool kIsPointer = true;
  static T* get(const KernelArg& arg) { return static_cast<T*>(arg.pointer); }
};

template <unsigned... I>
struct Indices {};
template <unsigned N, unsigned... I>
struct MakeIndices : MakeIndices<N - 1, N - 1, I...> {};
template <unsigned... I>
struct MakeIndices<0, I...> {
  using Type = Indices<I...>;
};

template <auto kFunction>
struct Wrapper;
template <class... Args, void (*kFunction)(Args...)>
struct Wrapper<kFunction> {
  static constexpr unsigned kCount = sizeof...(Args);
  static constexpr bool kPointers[] = {Argument<Args>::kIsPointer...};

  template <unsigned... I>
  static void call(const KernelArg* args, Indices<I...>) {
    kFunction(Argument<Args>::get(args[I])...);
  }
  static void run(const KernelArg* args, unsigned long begin, unsigned long end) {
#if defined(__SSE__)
    // Denormals cost a hundred cycles each and mean nothing at 1e-38 m: flush them meanwhile.
    const unsigned before = _mm_getcsr();
    _mm_setcsr(before | 0x8040);
#endif
    for (current_item = begin; current_item < end; ++current_item)
      call(args, typename MakeIndices<kCount>::Type{});
#if defined(__SSE__)
    _mm_setcsr(before);
#endif
  }
};

#define TLED_ENTRY(name) \
  {#name, Wrapper<&name>::kCount, Wrapper<&name>::kPointers, Wrapper<&name>::run}
constexpr KernelEntry kEntries[] = {
    TLED_ENTRY(step_rows_physical),
    TLED_ENTRY(step_rows_kappa),
    TLED_ENTRY(step_rows_cubes),
    TLED_ENTRY(force_rows_physical),
    TLED_ENTRY(apply_loads),
    TLED_ENTRY(apply_pressure),
    TLED_ENTRY(prescribe_values),
    TLED_ENTRY(prescribe_fields),
    TLED_ENTRY(force_rows_kappa),
    TLED_ENTRY(swap_blocks),
    TLED_ENTRY(step_levels_physical),
    TLED_ENTRY(step_levels_cubes),
    TLED_ENTRY(step_levels_kappa),
    TLED_ENTRY(element_state),
    TLED_ENTRY(element_growth),
    TLED_ENTRY(hex_forces_physical),
    TLED_ENTRY(hex_forces_kappa),
    TLED_ENTRY(hex_integrate_nodes),
    TLED_ENTRY(hex_gather_forces),
    TLED_ENTRY(hex_state),
    TLED_ENTRY(hex_growth),
    TLED_ENTRY(slide_nodes),
    TLED_ENTRY(step_sliding_physical),
    TLED_ENTRY(step_sliding_cubes),
    TLED_ENTRY(step_sliding_kappa),
    TLED_ENTRY(keep_ways_back),
    TLED_ENTRY(element_bounds),
    TLED_ENTRY(hex_bounds),
    TLED_ENTRY(node_squares),
    TLED_ENTRY(hex_node_squares),
    TLED_ENTRY(largest_squares),
    TLED_ENTRY(find_non_finite),
    TLED_ENTRY(reduce_largest),
    TLED_ENTRY(stiffest_element),
    TLED_ENTRY(hex_stiffest_element),
    TLED_ENTRY(scale_last_step),
    TLED_ENTRY(grid_nearest),
    TLED_ENTRY(roofline_axpy),
    TLED_ENTRY(roofline_copy),
    TLED_ENTRY(roofline_mixed),
};
constexpr tledface::native::KernelTable kTable = {TLED_INSTRUCTION_SET, TLED_LANES, kEntries,
                                                  sizeof kEntries / sizeof kEntries[0]};

}  // namespace

namespace tledface::native {
const KernelTable& TLED_TABLE();
const KernelTable& TLED_TABLE() { return kTable; }
#if TLED_COUNTED
OperationCounts take_operation_counts() {
  const OperationCounts taken = counts;
  counts = OperationCounts();
  return taken;
}
#endif
}  // namespace tledface::native
