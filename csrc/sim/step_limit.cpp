#include "sim/step_limit.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <numeric>

#include "core/threads.hpp"
#include "sim/simulator.hpp"

namespace tledface {
namespace {

// Lanczos: it ends when the residual of the largest Ritz value is this share of it.
constexpr int kFewestIterations = 12, kMostIterations = 48;
constexpr double kEnough = 0.01;
// Share of the Ritz value added on top of its residual: for finite differences, the operator's
// unsymmetric part (fibre stress over J) and a mode that the iteration has not met.
constexpr double kMargin = 0.03;
// Growth of the nodes' bounds up to which the last iteration is scaled, and its power: the bound of
// a contracted body is closer to the limit than that of one at rest, so the operator grows faster
// than the bounds (power 2.5 from rest to a stretch of 0.65).
constexpr double kTrustedGrowth = 1.05, kGrowthPower = 2.5;
// Largest displacement of the finite differences over the shortest edge.
constexpr double kDifference = 1e-6;

// Numbers that one work-item of a sum or a loop over vectors takes; sums are in one order for any
// number of threads.
constexpr std::size_t kChunk = 16384;

// Sum of term(i), which may change what belongs to i.
template <class Term>
double sum_of(std::size_t n, Term term) {
  std::vector<double> sums((n + kChunk - 1) / kChunk);
  parallel_for_chunks(n, kChunk, [&](std::size_t begin, std::size_t end) {
    double sum = 0;
    for (std::size_t i = begin; i < end; ++i) sum += term(i);
    sums[begin / kChunk] = sum;
  });
  return std::accumulate(sums.begin(), sums.end(), 0.0);
}

template <class Term>
double largest_of(std::size_t n, Term term) {
  std::vector<double> found((n + kChunk - 1) / kChunk);
  parallel_for_chunks(n, kChunk, [&](std::size_t begin, std::size_t end) {
    double largest = 0;
    for (std::size_t i = begin; i < end; ++i) largest = std::max(largest, term(i));
    found[begin / kChunk] = largest;
  });
  return *std::max_element(found.begin(), found.end());
}

double dot(const std::vector<double>& a, const std::vector<double>& b) {
  return sum_of(a.size(), [&](std::size_t i) { return a[i] * b[i]; });
}

template <class Body>
void for_each(std::size_t n, Body body) {
  parallel_for_chunks(n, kChunk, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) body(i);
  });
}

// Largest eigenvalue of a symmetric tridiagonal matrix by bisection on Sturm counts, and the last
// component of its unit eigenvector.
struct Ritz {
  double value, last;
};

Ritz largest_ritz(const std::vector<double>& alpha, const std::vector<double>& beta) {
  const std::size_t n = alpha.size();
  double low = *std::max_element(alpha.begin(), alpha.end()), high = low;
  for (std::size_t i = 0; i < n; ++i)
    high = std::max(
        high, alpha[i] + (i ? std::abs(beta[i - 1]) : 0) + (i + 1 < n ? std::abs(beta[i]) : 0));
  for (int i = 0; i < 200 && high - low > 1e-13 * std::abs(high); ++i) {
    const double middle = 0.5 * (low + high);
    double q = alpha[0] - middle;
    bool above = q > 0;  // an eigenvalue lies above `middle`
    for (std::size_t k = 1; k < n && !above; ++k) {
      q = alpha[k] - middle - beta[k - 1] * beta[k - 1] / q;
      above = q > 0;
    }
    (above ? low : high) = middle;
  }
  // Eigenvector by the recurrence from the first row.
  std::vector<double> v(n, 0.0);
  v[0] = 1;
  for (std::size_t k = 0; k + 1 < n; ++k)
    v[k + 1] = ((high - alpha[k]) * v[k] - (k ? beta[k - 1] * v[k - 1] : 0)) / beta[k];
  return {high, std::abs(v[n - 1]) / std::sqrt(dot(v, v))};
}

// Every node held: no step is too long.
TimeStepBound bound_of(const StepBounds::Largest& largest) {
  return {largest.square > 0 ? 2 / std::sqrt(largest.square) : HUGE_VAL, largest.node,
          largest.element};
}

}  // namespace

StepLimiter::StepLimiter(Simulator& sim, std::unique_ptr<StepBounds> bounds)
    : sim_(sim),
      model_(sim.model()),
      given_(sim.arrays()),
      node_mass_(sim.arrays().node_mass),
      bounds_(std::move(bounds)),
      host_([&] {
        SimulatorOptions options = sim.options();
        options.precision = Precision::kDouble;
        options.kernels = KernelPath::kRows;
        options.n_bands = 0;
        options.axis_order = sim.arrays().order;  // the past is in these axes
        options.arrays = sim.evaluator().shared_arrays();
        return std::make_unique<Simulator>(make_native_device(), sim.model(), options);
      }()),
      arrays_(host_->arrays()) {}

StepLimiter::~StepLimiter() = default;

double StepLimiter::highest_square(const std::vector<double>& activations) {
  ++iterations_;
  const auto u = sim_.displacement(), past = sim_.history(), node_squares = bounds_->squares();
  const std::size_t n = u.size(), lanes = arrays_.lanes;
  std::vector<double> inverse_root(n), q(n), before(n, 0.0), w(n), force(n);
  const double highest = *std::max_element(node_squares.begin(), node_squares.end());
  // Every mode has a part in the start; those of the stiffest nodes the most.
  std::uint64_t random = 0x9e3779b97f4a7c15u;
  for (std::size_t i = 0; i < n; ++i) {
    random = random * 6364136223846793005u + 1442695040888963407u;
    const double noise = static_cast<double>(random >> 11) / 9007199254740992.0 - 0.5;
    const double weight = node_squares[i / 3] / highest;
    inverse_root[i] = model_.fixed[i] ? 0 : 1 / std::sqrt(node_mass_[i / 3]);
    q[i] = model_.fixed[i] ? 0 : noise * weight * weight;
  }
  const double length = std::sqrt(dot(q, q));
  for (double& value : q) value /= length;

  // Where the host has component i of the nodal vectors.
  std::array<std::size_t, 3> axis{};
  for (std::size_t a = 0; a < 3; ++a) axis[arrays_.order[a]] = a;
  std::vector<std::uint32_t> place(n);  // blocks are few enough, see place_voxels
  for_each(n, [&](std::size_t i) {
    const std::size_t slot = arrays_.node_slot[i / 3];
    place[i] = static_cast<std::uint32_t>((slot / lanes * 3 + axis[i % 3]) * lanes + slot % lanes);
  });
  double* const moved = host_->displacement_in_place();
  for_each(n, [&](std::size_t i) { moved[place[i]] = u[i]; });
  const double* pushed = host_->instant_force_in_place(
      past.empty() ? past : history_in_layout(model_, given_, past, arrays_), activations);
  for_each(n, [&](std::size_t i) { force[i] = pushed[place[i]]; });
  const double edge = model_.shortest_edge();
  std::vector<double> alpha, beta;
  double largest = largest_of(n, [&](std::size_t i) { return std::abs(inverse_root[i] * q[i]); });
  for (int iteration = 0; iteration < kMostIterations; ++iteration) {
    const double step = kDifference * edge / largest;
    for_each(n, [&](std::size_t i) { moved[place[i]] = u[i] + step * inverse_root[i] * q[i]; });
    pushed = host_->instant_force_in_place({}, activations);
    const double last = beta.empty() ? 0 : beta.back();
    alpha.push_back(sum_of(n, [&](std::size_t i) {
      w[i] = inverse_root[i] * (pushed[place[i]] - force[i]) / step - last * before[i];
      return w[i] * q[i];
    }));
    const double rest = std::sqrt(sum_of(n, [&](std::size_t i) {
      w[i] -= alpha.back() * q[i];
      return w[i] * w[i];
    }));
    const Ritz ritz = largest_ritz(alpha, beta);
    const double residual = rest * ritz.last;
    const bool done = iteration + 1 >= kFewestIterations && residual < kEnough * ritz.value;
    if (done || iteration + 1 == kMostIterations || rest <= 1e-12 * ritz.value)
      return (1 + kMargin) * (ritz.value + residual);
    beta.push_back(rest);
    before.swap(q);
    largest = largest_of(n, [&](std::size_t i) {
      q[i] = w[i] / rest;
      return std::abs(inverse_root[i] * q[i]);
    });
  }
  return HUGE_VAL;
}

std::vector<double> StepLimiter::last_squares() const {
  return last_square_ > 0 ? bounds_->kept_squares() : std::vector<double>();
}

void StepLimiter::restore(const std::vector<double>& squares, double square) {
  last_square_ = square;
  if (square > 0) bounds_->set_kept_squares(squares);
}

StepLimit StepLimiter::limit(const FibreReach& reach, double enough) {
  const bool base_only = model_.laws.empty();
  auto largest = bounds_->evaluate(sim_.displacement_buffer(), reach,
                                   last_square_ > 0 ? last_square_ : HUGE_VAL);
  StepLimit result;
  result.bound = bound_of(largest);
  result.dt = result.bound.dt;
  if (!(result.bound.dt > 0) || !std::isfinite(result.bound.dt)) return result;
  if (!(last_square_ > 0)) largest.since = HUGE_VAL;
  const auto scaled = [&] {
    if (largest.since > kTrustedGrowth) return result.bound.dt;
    const double limit =
        2 / std::sqrt(last_square_ * std::pow(largest.since, kGrowthPower) * largest.reach);
    return base_only ? std::max(result.bound.dt, limit) : limit;
  };
  result.dt = scaled();
  if (result.dt < enough || (!base_only && enough > 0)) {
    last_square_ = highest_square(reach.activations);
    bounds_->keep_squares();
    largest.since = 1;
    largest.reach = bounds_->above(last_square_).reach;
    result.dt = scaled();
    result.iterated = true;
  }
  return result;
}

StepLimit StepLimiter::measure(const std::vector<double>& activations) {
  StepLimit result;
  result.bound = bound_of(bounds_->measure(sim_.displacement_buffer(), activations));
  result.dt = result.bound.dt;
  if (!(result.bound.dt > 0) || !std::isfinite(result.bound.dt)) return result;
  const double limit = 2 / std::sqrt(highest_square(activations));
  result.dt = model_.laws.empty() ? std::max(result.bound.dt, limit) : limit;
  result.iterated = true;
  return result;
}

}  // namespace tledface
