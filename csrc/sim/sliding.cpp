#include "sim/sliding.hpp"

#include <algorithm>
#include <cmath>
#include <string>

#include "broad_phase/sliding_layout.hpp"
#include "core/error.hpp"

namespace tledface {
namespace {

// Work-items a group; on the native device, a reason to deal them out in chunks.
constexpr std::size_t kGroup = 64;

std::unique_ptr<Buffer> upload(Device& device, const std::vector<double>& values,
                               Precision precision) {
  auto buffer = device.allocate(values.size() * real_size(precision));
  if (precision == Precision::kDouble) {
    buffer->write(values.data(), values.size() * sizeof(double));
  } else {
    const std::vector<float> narrow(values.begin(), values.end());
    buffer->write(narrow.data(), narrow.size() * sizeof(float));
  }
  return buffer;
}

std::unique_ptr<Buffer> upload(Device& device, const std::vector<std::int32_t>& values) {
  auto buffer = device.allocate(values.size() * sizeof(std::int32_t));
  buffer->write(values.data(), values.size() * sizeof(std::int32_t));
  return buffer;
}

void check(const SlidingNodes& given, const VoxelModel& model) {
  if (given.distance.size() != given.nodes.size() || given.surface.size() != given.nodes.size())
    throw InputError("sliding: nodes, distances and surfaces differ in length");
  for (std::size_t i = 0; i < given.nodes.size(); ++i) {
    if (given.nodes[i] < 0 || given.nodes[i] >= static_cast<std::int64_t>(model.n_nodes()))
      throw InputError("sliding: node " + std::to_string(given.nodes[i]) + " does not exist");
    if (given.surface[i] < 0 ||
        given.surface[i] >= static_cast<std::int32_t>(given.surfaces.size()))
      throw InputError("sliding: surface " + std::to_string(given.surface[i]) +
                       " does not exist");
  }
}

}  // namespace

Sliding::Sliding(const SlidingNodes& given, const VoxelModel& model, const SolverArrays& arrays,
                 Device& device, Program& program, Precision precision, bool vector_rows)
    : device_(device),
      precision_(precision),
      n_nodes_(given.nodes.size()),
      lanes_(arrays.lanes),
      order_(arrays.order) {
  check(given, model);
  const std::size_t lanes = lanes_;
  n_rows_ = (n_nodes_ + lanes - 1) / lanes;
  n_items_ = vector_rows ? n_rows_ : n_rows_ * lanes;
  // In the order of their slots, so that a row's nodes lie near each other in memory.
  std::vector<std::size_t> sorted(n_nodes_);
  for (std::size_t i = 0; i < n_nodes_; ++i) sorted[i] = i;
  std::sort(sorted.begin(), sorted.end(), [&](std::size_t a, std::size_t b) {
    return arrays.node_slot[given.nodes[a]] < arrays.node_slot[given.nodes[b]];
  });
  place_.resize(n_nodes_);

  Vec3 low{1e300, 1e300, 1e300}, high{-1e300, -1e300, -1e300};
  for (const std::int64_t node : given.nodes) {
    const auto at = model.position(node);
    low = min(low, Vec3{at[0], at[1], at[2]});
    high = max(high, Vec3{at[0], at[1], at[2]});
  }
  const Vec3 centre = 0.5 * (low + high);
  const SurfaceGrids grids = make_surface_grids(given.surfaces, centre, arrays.order);

  std::vector<double> rows(n_rows_ * SLIDE_ROWS * lanes, 0.0);
  std::vector<std::int32_t> ints(n_rows_ * SLIDE_INTS * lanes, 0);
  const auto empty = static_cast<std::int32_t>(std::size_t(arrays.n_blocks) * 3 * lanes);
  for (std::size_t place = 0; place < n_rows_ * lanes; ++place) {
    const std::size_t row = place / lanes, lane = place % lanes;
    const auto put = [&](int k, double value) {
      rows[(row * SLIDE_ROWS + k) * lanes + lane] = value;
    };
    const auto put_int = [&](int k, std::int32_t value) {
      ints[(row * SLIDE_INTS + k) * lanes + lane] = value;
    };
    if (place >= n_nodes_) {
      put_int(SLIDE_DOF, empty);
      put_int(SLIDE_SURFACE, -1);
      put(SLIDE_RADIUS, 1);
      put(SLIDE_LIMIT, 1);
      continue;
    }
    const std::size_t i = sorted[place];
    place_[i] = place;
    const std::int64_t node = given.nodes[i], slot = arrays.node_slot[node];
    put_int(SLIDE_DOF, static_cast<std::int32_t>(slot / lanes * 3 * lanes + slot % lanes));
    put_int(SLIDE_SURFACE, given.surface[i]);
    const auto at = model.position(node);
    std::int32_t free = 0;
    for (int a = 0; a < 3; ++a) {
      put(SLIDE_PLACE + a, at[arrays.order[a]] - centre[arrays.order[a]]);
      if (!model.fixed[3 * node + arrays.order[a]]) free |= 1 << a;
    }
    put_int(SLIDE_FREE, free);
    // Where rows are no vectors each lane has its own.
    if (free != 7)
      for (std::size_t l = 0; l < lanes; ++l)
        ints[(row * SLIDE_INTS + SLIDE_SHAPE) * lanes + l] |= 2;
    put(SLIDE_DISTANCE, given.distance[i]);
  }
  rows_ = reals(rows);
  ints_ = integers(ints);
  candidates_ = integers(std::vector<std::int32_t>(n_rows_ * lanes * SLIDE_CANDIDATES, 0));
  // A radius of 0: sought at the first step.
  candidate_reals_ = reals(std::vector<double>(n_rows_ * lanes * SLIDE_CANDIDATE_REALS, 0.0));
  triangles_ = reals(grids.triangles);
  grids_ = integers(grids.grids);
  grid_reals_ = reals(grids.grid_reals);
  cell_begin_ = integers(grids.cell_begin);
  cell_triangles_ = integers(grids.cell_triangles);
  for (auto& kernel : kernel_) kernel = program.kernel("slide_nodes");
}

std::unique_ptr<Buffer> Sliding::reals(const std::vector<double>& values) {
  auto buffer = upload(device_, values, precision_);
  bytes_ += buffer->bytes();
  return buffer;
}

std::unique_ptr<Buffer> Sliding::integers(const std::vector<std::int32_t>& values) {
  auto buffer = upload(device_, values);
  bytes_ += buffer->bytes();
  return buffer;
}

void Sliding::bind(const Buffer* const (&u)[2]) {
  for (int parity = 0; parity < 2; ++parity) {
    unsigned index = 0;
    for (const Buffer* buffer :
         {u[parity], static_cast<const Buffer*>(rows_.get()),
          static_cast<const Buffer*>(ints_.get()), static_cast<const Buffer*>(candidates_.get()),
          static_cast<const Buffer*>(candidate_reals_.get()),
          static_cast<const Buffer*>(triangles_.get()), static_cast<const Buffer*>(grids_.get()),
          static_cast<const Buffer*>(grid_reals_.get()),
          static_cast<const Buffer*>(cell_begin_.get()),
          static_cast<const Buffer*>(cell_triangles_.get())})
      kernel_[parity]->set_arg(index++, *buffer);
    kernel_[parity]->set_arg(index, static_cast<std::int32_t>(n_items_));
  }
}

void Sliding::enqueue(int next) { kernel_[next]->enqueue(n_items_, kGroup); }

std::vector<double> Sliding::normals() const {
  const std::size_t lanes = lanes_, count = n_rows_ * SLIDE_ROWS * lanes;
  std::vector<double> rows(count);
  device_.finish();
  if (precision_ == Precision::kDouble) {
    rows_->read(rows.data(), count * sizeof(double));
  } else {
    std::vector<float> narrow(count);
    rows_->read(narrow.data(), count * sizeof(float));
    std::copy(narrow.begin(), narrow.end(), rows.begin());
  }
  std::vector<double> result(3 * n_nodes_);
  for (std::size_t i = 0; i < n_nodes_; ++i) {
    const std::size_t row = place_[i] / lanes, lane = place_[i] % lanes;
    double length = 0;
    for (int a = 0; a < 3; ++a) {
      const double value = rows[(row * SLIDE_ROWS + SLIDE_ALONG + a) * lanes + lane];
      result[3 * i + order_[a]] = value;
      length += value * value;
    }
    for (int a = 0; a < 3 && length > 0; ++a) result[3 * i + a] /= std::sqrt(length);
  }
  return result;
}

std::vector<NearestTriangle> nearest_in_grid(Device& device, Precision precision,
                                             const TriangleMesh& surface,
                                             const std::vector<Vec3>& points) {
  ProgramOptions options;
  options.precision = precision;
  options.lanes = device.preferred_lanes(precision);
  options.vector_rows = device.prefers_vector_rows();
  auto program = device.build(options);
  const Bounds box = bounds(surface);
  const Vec3 centre = 0.5 * (box.low + box.high);
  const SurfaceGrids grids = make_surface_grids({surface}, centre, {0, 1, 2});
  std::vector<double> places;
  for (const Vec3& p : points)
    for (int a = 0; a < 3; ++a) places.push_back(p[a] - centre[a]);
  const std::size_t n = points.size();
  const auto places_buffer = upload(device, places, precision);
  const auto faces = upload(device, std::vector<std::int32_t>(n, -1));
  const auto squares = upload(device, std::vector<double>(n, 0.0), precision);
  const auto triangles = upload(device, grids.triangles, precision);
  const auto grid = upload(device, grids.grids);
  const auto grid_reals = upload(device, grids.grid_reals, precision);
  const auto begin = upload(device, grids.cell_begin);
  const auto items = upload(device, grids.cell_triangles);
  auto kernel = program->kernel("grid_nearest");
  unsigned index = 0;
  for (const Buffer* buffer : {places_buffer.get(), faces.get(), squares.get(), triangles.get(),
                               grid.get(), grid_reals.get(), begin.get(), items.get()})
    kernel->set_arg(index++, *buffer);
  kernel->set_arg(index++, static_cast<std::int32_t>(n));
  kernel->set_arg(index, std::int32_t(0));
  kernel->enqueue(n, kGroup);
  device.finish();
  std::vector<std::int32_t> found(n);
  faces->read(found.data(), n * sizeof(std::int32_t));
  std::vector<NearestTriangle> result(n);
  std::vector<double> wide(n);
  if (precision == Precision::kDouble) {
    squares->read(wide.data(), n * sizeof(double));
  } else {
    std::vector<float> narrow(n);
    squares->read(narrow.data(), n * sizeof(float));
    std::copy(narrow.begin(), narrow.end(), wide.begin());
  }
  for (std::size_t i = 0; i < n; ++i) result[i] = {found[i], wide[i]};
  return result;
}

}  // namespace tledface
