#include "bench/checks.hpp"

#include <algorithm>
#include <cmath>

namespace tledface::bench {
namespace {

constexpr int kEntries = 24, kEntryEvery = 8;

double work(const std::vector<double>& f0, const std::vector<double>& f1,
            const std::vector<double>& u0, const std::vector<double>& u1) {
  double sum = 0;
  for (std::size_t i = 0; i < u0.size(); ++i) sum += 0.5 * (f0[i] + f1[i]) * (u1[i] - u0[i]);
  return sum;
}

}  // namespace

Run::Run(std::shared_ptr<Device> device, const Workload& workload, const SimulatorOptions& options)
    : sim_(std::move(device), workload.model, options, {}, workload.sliding),
      speed_(workload.speed),
      activation_(workload.activation) {
  sim_.set_dt(0.8 * sim_.bound_at_rest().dt);
  restart();
}

void Run::restart() {
  const std::size_t n_nodes = sim_.model().n_nodes();
  std::vector<double> velocity;
  if (speed_ != 0) {
    velocity.assign(3 * n_nodes, 0.0);
    for (std::size_t n = 0; n < n_nodes; ++n) velocity[3 * n + 1] = speed_ / sim_.dt();
  }
  sim_.set_state(std::vector<double>(3 * n_nodes, 0.0), velocity, 0);
  steps_ = 0;
  full_at_ = kRise;
}

double Run::level(std::size_t step) const {
  return activation_ * std::min(1.0, static_cast<double>(step) / static_cast<double>(full_at_));
}

std::vector<double> Run::activations() const {
  return std::vector<double>(sim_.model().muscles.size(), level(steps_));
}

void Run::advance(std::size_t n) {
  const std::size_t n_muscles = sim_.model().muscles.size();
  std::vector<double> levels(n * n_muscles);
  for (std::size_t i = 0; i < n; ++i)
    std::fill_n(levels.begin() + static_cast<std::ptrdiff_t>(i * n_muscles), n_muscles,
                level(steps_ + i));
  sim_.step(n, {std::move(levels), {}, {}});
  steps_ += n;
}

void Run::contract(std::size_t n) {
  full_at_ = steps_ + n;
  advance(n);
}

EnergyBalance energy_balance(std::shared_ptr<Device> device, const Workload& workload,
                             const SimulatorOptions& options) {
  SimulatorOptions exact = options;
  exact.precision = Precision::kDouble;
  exact.kernels = KernelPath::kRows;
  exact.n_bands = 0;
  VoxelModel relaxed = workload.model;
  relaxed.muscles.clear();
  Run run(std::move(device), workload, options);
  Simulator& sim = run.simulator();
  Simulator host(make_native_device(), workload.model, exact);
  Simulator passive(make_native_device(), std::move(relaxed), exact);
  const auto& mass = sim.arrays().node_mass;
  const auto& gravity = sim.model().gravity;

  EnergyBalance result;
  result.elements = sim.model().n_elements();
  std::vector<double> last_u, last_force, u, force;
  double first = 0, largest = 0;
  for (int entry = 0; entry < kEntries; ++entry) {
    run.advance(kEntryEvery - 1);
    const auto activations = run.activations();
    u = sim.displacement();
    const auto before = sim.velocity();
    host.set_state(u, {}, 0);
    passive.set_state(u, {}, 0);
    force = passive.internal_force({});  // of the muscles: what is missing without them
    const auto all = host.internal_force(activations);
    for (std::size_t i = 0; i < force.size(); ++i) force[i] -= all[i];
    const auto state = sim.element_state(activations);
    result.strain = result.hourglass = result.kinetic = 0;
    for (std::size_t e = 0; e < result.elements; ++e) {
      result.strain += state.energy_density[e] * sim.model().element_volume(e);
      result.hourglass += state.hourglass_density[e] * sim.model().element_volume(e);
    }
    run.advance(1);
    const auto after = sim.velocity();
    double weight_work = 0;
    for (std::size_t n = 0; n < mass.size(); ++n)
      for (int c = 0; c < 3; ++c) {
        result.kinetic += 0.5 * mass[n] * before[3 * n + c] * after[3 * n + c];
        if (!last_u.empty())
          weight_work += mass[n] * gravity[c] * (u[3 * n + c] - last_u[3 * n + c]);
      }
    const double total = result.kinetic + result.strain + result.hourglass;
    if (entry == 0) {
      first = total;
    } else {
      result.muscle_work += work(last_force, force, last_u, u);
      result.external += weight_work;
    }
    largest = std::max({largest, std::abs(total), std::abs(result.muscle_work)});
    result.error = (total - first - result.muscle_work - result.external) / largest;
    last_u.swap(u);
    last_force.swap(force);
  }
  result.steps = kEntries * kEntryEvery;
  return result;
}

double float64_error(std::shared_ptr<Device> device, const Workload& workload,
                     const SimulatorOptions& options, std::size_t n_steps,
                     const std::vector<double>& single) {
  SimulatorOptions exact = options;
  exact.precision = Precision::kDouble;
  if (!device->info().has_double) {
    device = make_native_device();
    exact.kernels = KernelPath::kAuto;
  }
  Run run(std::move(device), workload, exact);
  run.advance(n_steps);
  const auto u = run.simulator().displacement();
  double difference = 0, largest = 0;
  for (std::size_t i = 0; i < u.size(); ++i) {
    largest = std::max(largest, std::abs(u[i]));
    const double off = std::abs(u[i] - single[i]);
    if (!(off <= difference)) difference = off;  // a NaN stays
  }
  return difference / largest;
}

}  // namespace tledface::bench
