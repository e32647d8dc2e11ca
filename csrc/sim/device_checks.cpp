#include "sim/device_checks.hpp"

#include <algorithm>

namespace tledface {
namespace {

// Work-items that go through the rows: so many whatever the device, with vectors enough for many
// cores, without them for a GPU. And how many of them one takes at each reduction.
constexpr std::int32_t kVectorItems = 256, kLaneItems = 16384, kTaken = 32;

}  // namespace

LargestFound::LargestFound(const Binder& binder, Precision precision, RowShape rows)
    : precision_(precision),
      vectors_(rows.vectors),
      most_items_(rows.vectors ? kVectorItems : kLaneItems) {
  for (int i = 0; i < 2; ++i) {
    values_[i] = binder.allocate(3 * most_items_ * real_size(precision), bytes_);
    // Of the place, and of what is found by it.
    places_[i] =
        binder.allocate(std::max<std::size_t>(most_items_, 2) * sizeof(std::int32_t), bytes_);
  }
  for (int i = 0; i < 2; ++i)
    reduce_[i] = binder.make(
        "reduce_largest",
        {values_[i].get(), places_[i].get(), values_[1 - i].get(), places_[1 - i].get()}, {0, 0});
}

std::int32_t LargestFound::n_items(std::int32_t n_rows) const {
  return std::max(1, std::min(n_rows, most_items_));
}

void LargestFound::enqueue(Kernel& kernel, std::int32_t n_items) const {
  kernel.enqueue(static_cast<std::size_t>(n_items), vectors_ ? 1 : kCheckGroup);
}

const Buffer& LargestFound::reduced_places(std::int32_t n_items) {
  constexpr unsigned kItems = 4, kLeft = 5;
  left_ = 0;
  while (n_items > 1) {
    const std::int32_t n_left = (n_items + kTaken - 1) / kTaken;
    Kernel& kernel = *reduce_[left_];
    kernel.set_arg(kItems, n_items);
    kernel.set_arg(kLeft, n_left);
    kernel.enqueue(static_cast<std::size_t>(n_left), kCheckGroup);
    left_ = 1 - left_;
    n_items = n_left;
  }
  return *places_[left_];
}

std::array<double, 3> LargestFound::largest() const {
  const auto values = read_reals(*values_[left_], 3, precision_);
  return {values[0], values[1], values[2]};
}

StateChecks::StateChecks(const Binder& binder, Precision precision, RowShape rows,
                         std::int32_t n_blocks)
    : precision_(precision),
      n_rows_(3 * rows.of_blocks(n_blocks)),
      found_(binder, precision, rows) {
  n_items_ = found_.n_items(n_rows_);
  ratio_ = binder.allocate(real_size(precision), bytes_);
  find_ = binder.make("find_non_finite", {ratio_.get(), &found_.values(), &found_.places()},
                      {n_rows_, n_items_});
  scale_ = binder.make("scale_last_step", {ratio_.get(), ratio_.get(), ratio_.get()}, {n_rows_});
}

bool StateChecks::is_finite(const Buffer& u) {
  find_->set_arg(0, u);
  found_.enqueue(*find_, n_items_);
  found_.reduced_places(n_items_);
  return found_.largest()[0] == 0;
}

void StateChecks::scale_last_step(const Buffer& u, const Buffer& u_prev, double ratio) {
  write_reals(*ratio_, {ratio}, precision_);
  scale_->set_arg(0, u);
  scale_->set_arg(1, u_prev);
  scale_->enqueue(static_cast<std::size_t>(n_rows_), kCheckGroup);
}

}  // namespace tledface
