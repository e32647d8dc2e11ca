#include "sim/snapshot.hpp"

#include <utility>

#include "precompute/layout.hpp"
#include "sim/simulator.hpp"

namespace tledface {
namespace {

std::vector<double> widened(const void* bytes, std::size_t count, Precision precision) {
  if (precision == Precision::kDouble) {
    const auto* values = static_cast<const double*>(bytes);
    return std::vector<double>(values, values + count);
  }
  const auto* values = static_cast<const float*>(bytes);
  return std::vector<double>(values, values + count);
}

}  // namespace

std::unique_ptr<Snapshot> Simulator::snapshot(const std::vector<double>& activations) {
  check_activations("snapshot", activations);
  return std::unique_ptr<Snapshot>(new Snapshot(*this, activations));
}

Snapshot::Snapshot(Simulator& sim, std::vector<double> activations)
    : sim_(sim),
      activations_(std::move(activations)),
      time_(sim.time()),
      next_dt_(sim.starts() ? 0 : sim.dt()),
      n_steps_(sim.n_steps()),
      u_(sim.displacement_buffer().read_later()) {
  if (sim.arrays().n_history_rows) history_ = sim.history_buffer().read_later();
}

std::vector<double> Snapshot::displacement() {
  const SolverArrays& arrays = sim_.arrays();
  const std::size_t count = std::size_t(arrays.n_blocks + 1) * arrays.lanes * 3;
  return slots_to_nodes(arrays, widened(u_->bytes(), count, sim_.options().precision));
}

ElementState Snapshot::element_state() {
  const SolverArrays& arrays = sim_.arrays();
  std::vector<double> past;
  if (history_)
    past = widened(history_->bytes(), std::size_t(arrays.n_history_rows) * arrays.lanes,
                   sim_.options().precision);
  return sim_.element_state_at(displacement(), past, activations_, next_dt_, time_);
}

}  // namespace tledface
