#include "sim/step_bounds.hpp"

#include <algorithm>
#include <cmath>

#include "core/threads.hpp"
#include "precompute/layout.hpp"
#include "precompute/time_step.hpp"

namespace tledface {
namespace {

// Stretches at which a fibre's slope within its reach is looked at.
constexpr std::int32_t kReachSamples = 7;
// Roundings in a row from the displacements to a node's square, each of half a unit in the last
// place: some 60 of products, sums and narrowed constants, and those of the volume ratio twice (it
// is squared), each of which counts |F| |cof F| / J times, taken as 16: a squeeze to a third.
constexpr double kRoundings = 512;

}  // namespace

StepBounds::StepBounds(Device& device, Program& program, const VoxelModel& model,
                       const SolverArrays& arrays, const SolverBuffers& buffers,
                       const HexahedraBuffers& hexahedra, Precision precision, RowShape rows)
    : arrays_(arrays),
      device_(device),
      precision_(precision),
      rows_(rows),
      conforming_(model.conforming()),
      margin_(kRoundings * std::ldexp(1.0, precision == Precision::kSingle ? -24 : -53)),
      found_(Binder(device, program), precision, rows) {
  const Binder binder(device, program);
  const std::int32_t n_blocks = arrays.n_blocks, n_rows = rows.of_blocks(n_blocks);
  const std::size_t n_slots = std::size_t(n_blocks + 1) * arrays.lanes;
  n_items_ = found_.n_items(n_rows);
  const auto allocate = [&](std::size_t count) {
    return binder.allocate(count * real_size(precision), bytes_);
  };
  look_values_.assign(LOOK_ACTIVATION + model.muscles.size(), 0.0);
  look_ = allocate(look_values_.size());
  for (auto* buffer : {&rest_, &reached_elements_, &reached_squares_, &kept_squares_})
    *buffer = allocate(n_slots);
  if (!model.muscles.empty())
    for (auto* buffer : {&exact_elements_, &exact_squares_}) *buffer = allocate(n_slots);

  const auto stiffness = tissue_stiffness(model);
  std::vector<double> rest(n_slots, 0.0);
  node_at_.assign(n_slots, -1);
  element_at_.assign(n_slots, -1);
  parallel_for_chunks(stiffness.size(), 4096, [&](std::size_t begin, std::size_t end) {
    for (std::size_t e = begin; e < end; ++e) {
      rest[arrays.element_slot[e]] = stiffness[e] * model.element_volume(e) / 2;
      element_at_[arrays.element_slot[e]] = static_cast<std::int32_t>(e);
    }
  });
  for (std::size_t n = 0; n < arrays.node_slot.size(); ++n)
    node_at_[arrays.node_slot[n]] = static_cast<std::int32_t>(n);
  write_reals(*rest_, rest, precision);

  const Buffer* exact = exact_elements_ ? exact_elements_.get() : look_.get();
  const auto n_slots_here = static_cast<std::int32_t>(n_slots - arrays.lanes);
  if (conforming_) {
    elements_ =
        binder.make("hex_bounds",
                    {look_.get(), rest_.get(), reached_elements_.get(), exact, buffers.blocks,
                     buffers.muscle_entries, buffers.muscle_sets, buffers.muscle_constants,
                     hexahedra.nodes, hexahedra.rows, look_.get()},
                    {n_blocks, 1});
    nodes_ = binder.make("hex_node_squares",
                         {rest_.get(), rest_.get(), buffers.blocks, buffers.node_sets,
                          hexahedra.begin, hexahedra.places},
                         {n_slots_here});
    stiffest_ = binder.make("hex_stiffest_element",
                            {&found_.places(), reached_elements_.get(), hexahedra.rows,
                             hexahedra.begin, hexahedra.places},
                            {});
  } else {
    elements_ = binder.make("element_bounds",
                            {look_.get(), rest_.get(), reached_elements_.get(), exact,
                             buffers.blocks, buffers.muscle_entries, buffers.muscle_sets,
                             buffers.muscle_constants, buffers.shape, look_.get()},
                            {n_blocks, 1});
    nodes_ = binder.make("node_squares",
                         {rest_.get(), rest_.get(), buffers.blocks, buffers.node_sets}, {n_blocks});
    stiffest_ = binder.make("stiffest_element",
                            {&found_.places(), reached_elements_.get(), buffers.blocks}, {});
  }
  largest_ = binder.make("largest_squares",
                         {rest_.get(), rest_.get(), kept_squares_.get(), look_.get(),
                          &found_.values(), &found_.places()},
                         {n_rows, n_items_});
}

void StepBounds::write_look() { write_reals_later(*look_, look_values_, precision_); }

void StepBounds::find_elements(const Buffer& u, const FibreReach& reach, double threshold) {
  const bool reaches = exact_elements_ && (reach.low != 1 || reach.high != 1);
  const std::int32_t n_samples = reaches ? kReachSamples : 1;
  look_values_[LOOK_REACH] = reach.low;
  look_values_[LOOK_REACH_STEP] = (reach.high - reach.low) / (kReachSamples - 1);
  std::copy(reach.activations.begin(), reach.activations.end(),
            look_values_.begin() + LOOK_ACTIVATION);
  // Lower by the rounding, so that no node is left out that should count.
  look_values_[LOOK_THRESHOLD] = threshold * (1 - 2 * margin_);
  write_look();
  const unsigned samples = conforming_ ? 12 : 11;
  elements_->set_arg(0, u);
  elements_->set_arg(samples, n_samples);
  elements_->enqueue(static_cast<std::size_t>(rows_.of_blocks(arrays_.n_blocks)), kCheckGroup);
  elements_now_ = reaches ? exact_elements_.get() : reached_elements_.get();
}

void StepBounds::find_squares(const Buffer& elements, const Buffer& squares) {
  nodes_->set_arg(0, elements);
  nodes_->set_arg(1, squares);
  const RowShape of_nodes{rows_.vectors && !conforming_, rows_.lanes};
  nodes_->enqueue(static_cast<std::size_t>(of_nodes.of_blocks(arrays_.n_blocks)), kCheckGroup);
}

StepBounds::Largest StepBounds::evaluate(const Buffer& u, const FibreReach& reach,
                                         double threshold) {
  find_elements(u, reach, threshold);
  find_squares(*reached_elements_, *reached_squares_);
  most_squares_ = squares_now_ = reached_squares_.get();
  has_reached_ = true;
  if (elements_now_ != reached_elements_.get()) {
    find_squares(*exact_elements_, *exact_squares_);
    squares_now_ = exact_squares_.get();
  }
  return find_largest();
}

StepBounds::Largest StepBounds::measure(const Buffer& u, const std::vector<double>& activations) {
  if (!measured_squares_) measured_squares_ = device_.allocate(reached_squares_->bytes());
  find_elements(u, {activations, 1, 1}, HUGE_VAL);
  find_squares(*reached_elements_, *measured_squares_);
  most_squares_ = squares_now_ = measured_squares_.get();
  return find_largest();
}

StepBounds::Largest StepBounds::above(double threshold) {
  look_values_[LOOK_THRESHOLD] = threshold * (1 - 2 * margin_);
  write_look();
  return find_largest();
}

StepBounds::Largest StepBounds::find_largest() {
  largest_->set_arg(0, *most_squares_);
  largest_->set_arg(1, *squares_now_);
  largest_->set_arg(2, *kept_squares_);
  found_.enqueue(*largest_, n_items_);
  const Buffer& places = found_.reduced_places(n_items_);
  stiffest_->set_arg(0, places);
  stiffest_->enqueue(1, 1);
  std::int32_t slots[2];
  places.read(slots, sizeof slots);
  const auto [square, since, reach] = found_.largest();
  if (!(square > 0)) return {};
  Largest largest;
  largest.square = square * (1 + margin_);
  largest.node = static_cast<std::size_t>(node_at_[slots[0]]);
  largest.element = static_cast<std::size_t>(element_at_[slots[1]]);
  // Quotients of two squares.
  largest.since = since * (1 + 2 * margin_);
  if (squares_now_ != most_squares_) largest.reach = reach * (1 + 2 * margin_);
  return largest;
}

std::vector<double> StepBounds::at_nodes(const Buffer& squares, double scale) const {
  const auto at_slot = read_reals(squares, node_at_.size(), precision_);
  std::vector<double> result(arrays_.node_slot.size());
  for (std::size_t n = 0; n < result.size(); ++n) result[n] = at_slot[arrays_.node_slot[n]] * scale;
  return result;
}

std::vector<double> StepBounds::squares() const { return at_nodes(*squares_now_, 1); }

void StepBounds::keep_squares() { find_squares(*elements_now_, *kept_squares_); }

std::vector<double> StepBounds::kept_squares() const { return at_nodes(*kept_squares_, 1); }

void StepBounds::set_kept_squares(const std::vector<double>& squares) {
  std::vector<double> at_slot(node_at_.size(), 0.0);
  for (std::size_t n = 0; n < squares.size(); ++n) at_slot[arrays_.node_slot[n]] = squares[n];
  write_reals(*kept_squares_, at_slot, precision_);
}

std::vector<double> StepBounds::reached_squares() const {
  if (!has_reached_) return {};
  return at_nodes(*reached_squares_, 1 + margin_);
}

}  // namespace tledface
