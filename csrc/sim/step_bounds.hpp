// The bounds of nodes under a deformation (precompute/time_step.hpp), on the device and in its
// precision; only what decides comes to the host. Kernels: kernels_cl/step_bounds.cl.
#pragma once
#include <memory>
#include <vector>

#include "precompute/voxel_model.hpp"
#include "sim/device_checks.hpp"
#include "sim/force_path.hpp"

namespace tledface {

// What fibres do: an activation for each muscle, and the shares of their stretch within which the
// steepest slope is taken.
struct FibreReach {
  std::vector<double> activations;
  double low = 1, high = 1;
};

class StepBounds {
 public:
  struct Largest {
    double square = 0;  // omega^2, 1/s^2; 0: every node is held; infinite: an element is inverted
    std::size_t node = 0, element = 0;  // whose it is, and the stiffest of that node's elements
    // Growth, at least 1, of nodes whose omega^2 is above a threshold: since squares were kept, and
    // from those of now to what fibres reach.
    double since = 1, reach = 1;
  };

  StepBounds(Device& device, Program& program, const VoxelModel& model, const SolverArrays& arrays,
             const SolverBuffers& buffers, const HexahedraBuffers& hexahedra, Precision precision,
             RowShape rows);

  // At displacement u; what is asked below is of the last call.
  Largest evaluate(const Buffer& u, const FibreReach& reach, double threshold);
  // The same for a look that leaves no trace in reached_squares() and kept_squares().
  Largest measure(const Buffer& u, const std::vector<double>& activations);
  // Once more with another threshold.
  Largest above(double threshold);
  // omega^2 of each node without the reach, 0 where it is held.
  std::vector<double> squares() const;
  // Keeps those, for the growth since.
  void keep_squares();
  std::vector<double> kept_squares() const;
  void set_kept_squares(const std::vector<double>& squares);
  // With the reach, of the last evaluate(); empty before it.
  std::vector<double> reached_squares() const;

  // Share by which all squares are above what the device computed, so that rounding never puts a
  // bound below the truth.
  double margin() const { return margin_; }
  std::size_t bytes() const { return bytes_ + found_.bytes(); }

 private:
  void find_elements(const Buffer& u, const FibreReach& reach, double threshold);
  void write_look();
  void find_squares(const Buffer& elements, const Buffer& squares);
  Largest find_largest();
  std::vector<double> at_nodes(const Buffer& squares, double scale) const;

  const SolverArrays& arrays_;
  Device& device_;
  Precision precision_;
  RowShape rows_;
  bool conforming_;
  double margin_;
  std::size_t bytes_ = 0;
  LargestFound found_;
  std::int32_t n_items_;
  std::vector<double> look_values_;
  std::unique_ptr<Buffer> look_, rest_, reached_elements_, exact_elements_, reached_squares_,
      exact_squares_, kept_squares_, measured_squares_;
  // Of the last evaluate() or measure().
  const Buffer *elements_now_ = nullptr, *most_squares_ = nullptr, *squares_now_ = nullptr;
  bool has_reached_ = false;
  std::unique_ptr<Kernel> elements_, nodes_, largest_, stiffest_;
  // By slot: the node and the element, -1 where there is none.
  std::vector<std::int32_t> node_at_, element_at_;
};

}  // namespace tledface
