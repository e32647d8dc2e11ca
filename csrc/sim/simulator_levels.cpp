// The parts of Simulator that subcycle: which block takes which step, and what changes with that.
#include <cmath>
#include <string>

#include "core/error.hpp"
#include "precompute/layout.hpp"
#include "sim/simulator.hpp"

namespace tledface {

void Simulator::set_substeps(std::int64_t substeps) {
  BlockLevels levels = same_level(arrays_);
  while (levels.substeps() < substeps && levels.n_levels < TLED_MOST_LEVELS) ++levels.n_levels;
  if (levels.substeps() != substeps)
    throw InputError("substeps: got " + std::to_string(substeps) +
                     ", allowed are 1, 2, 4, 8 or 16");
  if (substeps > 1 && !path_->subcycles())
    throw InputError(std::string("substeps: ") + kernels() +
                     " kernels take steps of one length; use kernels='rows'");
  take_levels(std::move(levels));
}

void Simulator::choose_levels() {
  if (levels_.n_levels == 1) return;
  const auto squares = limiter().reached_squares();
  if (squares.empty()) return;
  take_levels(tledface::choose_levels(model_, arrays_, squares, dt_, levels_.n_levels, levels_));
}

void Simulator::take_levels(BlockLevels levels) {
  if (levels.nodes == levels_.nodes && levels.elements == levels_.elements &&
      levels.n_levels == levels_.n_levels)
    return;
  if (levels.nodes != levels_.nodes) {
    const auto now = read_slots(*u_[now_]);
    auto before = read_slots(*u_[1 - now_]);
    const std::size_t reals = std::size_t(3) * arrays_.lanes;
    for (std::size_t b = 0; b < levels.nodes.size(); ++b) {
      if (levels.nodes[b] == levels_.nodes[b]) continue;
      const double ratio = std::ldexp(1.0, int(levels.nodes[b]) - int(levels_.nodes[b]));
      for (std::size_t i = b * reals; i < (b + 1) * reals; ++i)
        before[i] = now[i] - (now[i] - before[i]) * ratio;
    }
    write_reals(*u_[1 - now_], before);
  }
  forget_recordings();
  levels_ = std::move(levels);
  const auto links = links_with_levels(arrays_, levels_);
  blocks_->write(links.data(), links.size() * sizeof(std::int32_t));
  path_->set_levels(levels_);
  if (sliding_) sliding_->set_has_levels(levels_.n_levels > 1);
}

std::vector<std::int32_t> Simulator::node_steps() const {
  std::vector<std::int32_t> steps(arrays_.node_slot.size());
  for (std::size_t n = 0; n < steps.size(); ++n)
    steps[n] = 1 << levels_.nodes[arrays_.node_slot[n] / arrays_.lanes];
  return steps;
}

std::vector<double> Simulator::weighted_force(const std::vector<double>& activations) {
  check_activations("weighted_force", activations);
  return force_at(starts_ ? 0 : dt_, activations, true);
}

}  // namespace tledface
