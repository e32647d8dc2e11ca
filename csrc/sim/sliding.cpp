#include "sim/sliding.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include "broad_phase/near_points.hpp"
#include "broad_phase/sliding_layout.hpp"
#include "broad_phase/zones.hpp"
#include "core/error.hpp"
#include "sim/real_buffers.hpp"

namespace tledface {
namespace {

// Work-items a group; on the native device, a reason to deal them out in chunks.
constexpr std::size_t kGroup = 64;
// First byte of a state: what follows is laid out as by this version of the kernels, and where rows
// are those of blocks though they are no vectors.
constexpr std::uint8_t kLayout = 14, kTileLayout = 15;
// Where the kernel takes the index of the step in the table.
constexpr unsigned kStepIndex = 24, kKeepWays = 25, kHasLevels = 26;
// Whether nodes that left their balls wait in a queue for work-groups. CPUs have nothing to gain
// from groups, and PoCL 3.1 computes slide_queued wrongly (docs/explanation/gpu-kernels.md).
bool queues(const Device& device) { return device.info().kind == "gpu"; }
// Work-items of a group of slide_queued (SLIDE_ITEMS), and groups of it that a compute unit gets at
// most: as many as there is room for, so that each has a node or two.
constexpr std::size_t kQueueGroup = 32, kQueueGroupsPerUnit = 16;

std::unique_ptr<Buffer> upload(Device& device, const std::vector<double>& values,
                               Precision precision) {
  auto buffer = device.allocate(values.size() * real_size(precision));
  write_reals(*buffer, values, precision);
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
      throw InputError("sliding: surface " + std::to_string(given.surface[i]) + " does not exist");
  }
  for (const auto count : {given.friction.size(), given.release.size()})
    if (count && count != given.nodes.size())
      throw InputError("sliding: nodes and their friction or release differ in length");
  for (const std::int32_t surface : given.moving)
    if (surface < 0 || surface >= static_cast<std::int32_t>(given.surfaces.size()))
      throw InputError("sliding: surface " + std::to_string(surface) + " does not exist");
}

// Nothing is known of where nodes slide; lanes without one are never looked at.
std::vector<double> unknown_rows(const std::vector<double>& records, std::size_t lanes) {
  const std::size_t n_places = records.size() / RECORD_REALS;
  std::vector<double> rows(n_places * SLIDE_ROWS, 0.0);
  for (std::size_t row = 0; row < n_places / lanes; ++row)
    for (std::size_t lane = 0; lane < lanes; ++lane)
      if (records[(row * lanes + lane) * RECORD_REALS + RECORD_SURFACE] < 0)
        rows[(row * SLIDE_ROWS + SLIDE_SLACK) * lanes + lane] = 1e15;  // its square is a float
  return rows;
}

// How far from their surfaces nodes may be in a zone, before and behind: as far as they are to be
// and somewhat farther, for the way in a step; of far ones zones would be small.
std::vector<std::array<double, 2>> reach_of(const SlidingNodes& given, const SurfaceGrids& grids) {
  constexpr double kMore = 1.25, kLeast = 0.15,
                   kMost = 1.5;  // times; over the edge of a grid's cell
  std::vector<std::array<double, 2>> reach(given.surfaces.size(), {0.0, 0.0});
  for (std::size_t i = 0; i < given.nodes.size(); ++i) {
    const double cell = grids.grid_reals[given.surface[i] * GRID_REALS + 3], d = given.distance[i];
    double& far = reach[given.surface[i]][d < 0];
    far = std::max(far, std::min(kMore * std::abs(d) + kLeast * cell, kMost * cell));
  }
  return reach;
}

// Of each surface the triangles that nodes may come to, as far as can be said at rest: a quarter of
// what they take up along its longest side is farther than tissue slides, and 8 cells of the grid
// for few nodes. Zones of all of a head's bone take several seconds to make; nodes that do get
// farther are sought, which is slower and no less exact.
std::vector<std::vector<std::uint8_t>> triangles_for(const SlidingNodes& given,
                                                     const std::vector<Vec3>& positions,
                                                     const SurfaceGrids& grids) {
  constexpr double kSide = 0.25, kCells = 8;
  std::vector<std::vector<Vec3>> on(given.surfaces.size());
  for (std::size_t i = 0; i < positions.size(); ++i) on[given.surface[i]].push_back(positions[i]);
  std::vector<std::vector<std::uint8_t>> result;
  for (std::size_t s = 0; s < on.size(); ++s) {
    double longest = 0;
    for (int a = 0; a < 3 && !on[s].empty(); ++a) {
      const auto [low, high] = std::minmax_element(
          on[s].begin(), on[s].end(), [&](const Vec3& p, const Vec3& q) { return p[a] < q[a]; });
      longest = std::max(longest, (*high)[a] - (*low)[a]);
    }
    const double margin = std::max(kSide * longest, kCells * grids.grid_reals[s * GRID_REALS + 3]);
    result.push_back(triangles_near(grids, s, on[s], margin));
  }
  return result;
}

double rounding_of(Precision precision) { return precision == Precision::kDouble ? 1e-15 : 5e-8; }

}  // namespace

Sliding::Sliding(const SlidingNodes& given, const VoxelModel& model, const SolverArrays& arrays,
                 Device& device, Program& program, Precision precision, bool vector_rows,
                 bool tiles, std::int32_t pose_column)
    : device_(device),
      precision_(precision),
      n_nodes_(given.nodes.size()),
      n_moving_(given.moving.size()),
      lanes_(arrays.lanes),
      vector_rows_(vector_rows),
      queues_(false),
      of_blocks_(vector_rows),
      order_(arrays.order) {
  check(given, model);
  const std::size_t lanes = lanes_;
  has_laws_ =
      n_moving_ > 0 ||
      std::any_of(given.friction.begin(), given.friction.end(), [](double f) { return f > 0; }) ||
      std::any_of(given.release.begin(), given.release.end(), [](auto r) { return r != 0; });
  queues_ = queues(device) && !vector_rows && !has_laws_;
  of_blocks_ = vector_rows || (queues_ && tiles);
  // Surfaces that stand still, then each that moves: nodes of a row share the pose.
  std::vector<std::size_t> motion(given.surfaces.size(), 0);
  for (std::size_t m = 0; m < n_moving_; ++m) motion[given.moving[m]] = m + 1;
  // In the order of their slots. Vector rows, and those that tiles put back, are blocks of u, so
  // that they are read and written whole; other nodes of the block hold still in them.
  std::vector<std::size_t> sorted(n_nodes_);
  for (std::size_t i = 0; i < n_nodes_; ++i) sorted[i] = i;
  std::sort(sorted.begin(), sorted.end(), [&](std::size_t a, std::size_t b) {
    const std::size_t ma = motion[given.surface[a]], mb = motion[given.surface[b]];
    return ma != mb ? ma < mb : arrays.node_slot[given.nodes[a]] < arrays.node_slot[given.nodes[b]];
  });
  place_.resize(n_nodes_);
  std::vector<std::size_t> node_at;  // of each place; n_nodes_: none
  auto& block_at = block_of_row_;    // -1: of nodes from anywhere
  for (std::size_t i = 0; i < n_nodes_;) {
    const std::size_t moves = motion[given.surface[sorted[i]]], first_row = node_at.size() / lanes;
    for (; i < n_nodes_ && motion[given.surface[sorted[i]]] == moves; ++i) {
      const std::int64_t slot = arrays.node_slot[given.nodes[sorted[i]]];
      const auto block = static_cast<std::int32_t>(slot / static_cast<std::int64_t>(lanes));
      if (of_blocks_) {
        if (node_at.size() / lanes == first_row || block_at.back() != block) {
          node_at.resize(node_at.size() + lanes, n_nodes_);
          block_at.push_back(block);
        }
        place_[sorted[i]] = node_at.size() - lanes + slot % lanes;
        node_at[place_[sorted[i]]] = sorted[i];
      } else {
        place_[sorted[i]] = node_at.size();
        node_at.push_back(sorted[i]);
      }
    }
    node_at.resize((node_at.size() + lanes - 1) / lanes * lanes, n_nodes_);
    block_at.resize(node_at.size() / lanes, -1);
    const std::size_t n_rows = node_at.size() / lanes - first_row;
    const auto column = pose_column + static_cast<std::int32_t>((moves - 1) * kPoseValues);
    groups_.push_back({first_row, vector_rows ? n_rows : n_rows * lanes, moves ? column : -1, {}});
  }
  n_rows_ = node_at.size() / lanes;

  Vec3 low{1e300, 1e300, 1e300}, high{-1e300, -1e300, -1e300};
  for (const std::int64_t node : given.nodes) {
    const auto at = model.position(node);
    low = min(low, Vec3{at[0], at[1], at[2]});
    high = max(high, Vec3{at[0], at[1], at[2]});
  }
  centre_ = 0.5 * (low + high);
  const SurfaceGrids grids = make_surface_grids(given.surfaces, centre_, arrays.order);
  // As those of the triangles: from the centre, in the solver's axes.
  std::vector<Vec3> positions;
  for (const std::int64_t node : given.nodes) {
    const auto at = model.position(node);
    Vec3 p;
    for (int a = 0; a < 3; ++a) p[a] = at[arrays.order[a]] - centre_[arrays.order[a]];
    positions.push_back(p);
  }

  std::vector<double> regions(n_rows_ * REGION_ROWS * lanes, 0.0);
  std::vector<double> laws(has_laws_ ? n_rows_ * SLIDE_LAWS * lanes : 1, 0.0);
  std::vector<std::int32_t> ints(n_rows_ * SLIDE_INTS * lanes, 0);
  std::vector<double> records(n_rows_ * RECORD_REALS * lanes, 0.0);
  std::vector<std::int32_t> heads((n_rows_ + SLIDE_AHEAD) * SLIDE_HEAD, 0);
  if (vector_rows)
    for (std::size_t row = 0; row < n_rows_; ++row)
      heads[row * SLIDE_HEAD + HEAD_BLOCK] = block_of_row_[row];
  const auto empty = static_cast<std::int32_t>(std::size_t(arrays.n_blocks) * 3 * lanes);
  for (std::size_t place = 0; place < node_at.size(); ++place) {
    const std::size_t row = place / lanes, lane = place % lanes;
    const auto put = [&](int k, double value) {
      regions[(row * REGION_ROWS + k) * lanes + lane] = value;
    };
    const auto put_int = [&](int k, std::int32_t value) {
      ints[(row * SLIDE_INTS + k) * lanes + lane] = value;
    };
    const auto put_law = [&](int k, double value) {
      laws[(row * SLIDE_LAWS + k) * lanes + lane] = value;
    };
    if (node_at[place] == n_nodes_) {
      put_int(SLIDE_DOF, block_of_row_[row] < 0
                             ? empty
                             : static_cast<std::int32_t>(block_of_row_[row] * 3 * lanes + lane));
      for (const int k : {RECORD_NEXT, RECORD_ZONE, RECORD_SURFACE})
        records[place * RECORD_REALS + k] = -1;
      continue;
    }
    const std::size_t i = node_at[place];
    const std::int64_t node = given.nodes[i], slot = arrays.node_slot[node];
    put_int(SLIDE_DOF, static_cast<std::int32_t>(slot / lanes * 3 * lanes + slot % lanes));
    std::int32_t free = 0;
    for (int a = 0; a < 3; ++a) {
      put(REGION_PLACE + a, positions[i][a]);
      records[place * RECORD_REALS + RECORD_PLACE + a] = positions[i][a];
      if (model.fixed[3 * node + arrays.order[a]]) continue;
      free |= 1 << a;
      if (has_laws_) put_law(SLIDE_MAY + a, 1);
    }
    records[place * RECORD_REALS + RECORD_SURFACE] = 8 * given.surface[i] + free;
    if (free != 7 && motion[given.surface[i]] == 0) {
      ints[(row * SLIDE_INTS + SLIDE_SHAPE) * lanes + lane] |= 1;
      if (vector_rows) heads[row * SLIDE_HEAD + HEAD_SHAPE] |= 1;
    }
    put(REGION_DISTANCE, given.distance[i]);
    for (const int k : {RECORD_NEXT, RECORD_ZONE}) records[place * RECORD_REALS + k] = -1;
    records[place * RECORD_REALS + RECORD_DISTANCE] = given.distance[i];
    if (!given.friction.empty() && has_laws_) put_law(SLIDE_FRICTION, given.friction[i]);
    if (!given.release.empty() && has_laws_) put_law(SLIDE_RELEASE, given.release[i] ? 1 : 0);
  }
  rows_ = reals(unknown_rows(records, lanes));
  regions_ = reals(regions);
  records_ = reals(records);
  heads_ = integers(heads);
  ints_ = integers(ints);
  laws_ = reals(laws);
  candidates_ = integers(std::vector<std::int32_t>(n_rows_ * lanes * SLIDE_CANDIDATES, 0));
  // A radius of 0: sought at the first step.
  candidate_reals_ = reals(std::vector<double>(n_rows_ * lanes * SLIDE_CANDIDATE_REALS, 0.0));
  triangles_ = reals(grids.triangles);
  Zones zones = make_zones(grids, reach_of(given, grids), triangles_for(given, positions, grids),
                           rounding_of(precision));
  // Behind the last there is room for the borders of a full one: they are read before their number
  // is.
  const std::size_t room = ZONE_BORDERS + ZONE_MOST_BORDERS * ZONE_BORDER_REALS;
  zones.reals.resize(zones.reals.size() + room, 0.0);
  zones_ = reals(zones.reals);
  triangle_zones_ = integers(zones.of_triangle);
  grids_ = integers(grids.grids);
  grid_reals_ = reals(grids.grid_reals);
  cell_begin_ = integers(grids.cell_begin);
  cell_triangles_ = integers(grids.cell_triangles);
  for (Group& group : groups_)
    for (auto& kernel : group.kernel) kernel = program.kernel("slide_nodes");
  if (queues_) {
    // Lanes without a sliding node, too, leave their balls where a state is not finite.
    queue_ = integers(std::vector<std::int32_t>(SLIDE_WAITING + n_rows_ * lanes, 0));
    n_groups_ = std::min<std::size_t>(
        n_nodes_, kQueueGroupsPerUnit * std::max(1u, device.info().compute_units));
    for (auto& kernel : still_) kernel = program.kernel("slide_still");
    for (auto& kernel : queued_) kernel = program.kernel("slide_queued");
  }
  if (of_blocks_ || queues_)
    for (auto& kernel : keep_ways_) kernel = program.kernel("keep_ways_back");
}

std::optional<SlidingRowBuffers> Sliding::row_buffers() const {
  if (has_laws_ || !of_blocks_) return std::nullopt;
  return SlidingRowBuffers{arguments(),    &block_of_row_, rows_.get(),
                           regions_.get(), ints_.get(),    queue_.get()};
}

std::vector<const Buffer*> Sliding::arguments() const {
  std::vector<const Buffer*> result;
  for (const auto* buffer :
       {&rows_, &regions_, &records_, &heads_, &ints_, &candidates_, &candidate_reals_, &triangles_,
        &grids_, &grid_reals_, &cell_begin_, &cell_triangles_, &zones_, &triangle_zones_})
    result.push_back(buffer->get());
  return result;
}

void Sliding::fill_poses(const double* values, double* columns) const {
  for (std::size_t m = 0; m < n_moving_; ++m)
    for (int moment = 0; moment < 2; ++moment) {
      const double* given = values + m * kPoseValues + moment * POSE_REALS;
      double* pose = columns + m * kPoseValues + moment * POSE_REALS;
      for (int a = 0; a < 3; ++a) {
        const double* line = given + 4 * order_[a];
        for (int b = 0; b < 3; ++b) pose[3 * a + b] = line[order_[b]];
        pose[9 + a] = line[0] * centre_.x + line[1] * centre_.y + line[2] * centre_.z + line[3] -
                      centre_[order_[a]];
      }
    }
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

void Sliding::bind(const Buffer* const (&u)[2], const Buffer& blocks, const Buffer& step_table,
                   std::int32_t step_reals) {
  const auto bind_nodes = [&](Kernel& kernel, const Buffer& next) {
    unsigned index = 0;
    for (const Buffer* buffer : arguments()) kernel.set_arg(index++, *buffer);
    kernel.set_arg(index++, next);
    return index;
  };
  for (int parity = 0; parity < 2; ++parity) {
    for (Group& group : groups_) {
      Kernel& kernel = *group.kernel[parity];
      unsigned index = bind_nodes(kernel, *u[parity]);
      for (const Buffer* buffer :
           {u[1 - parity], static_cast<const Buffer*>(laws_.get()), &blocks, &step_table})
        kernel.set_arg(index++, *buffer);
      for (const auto value :
           {static_cast<std::int32_t>(group.n_items), static_cast<std::int32_t>(group.first_row),
            std::int32_t(has_laws_), group.pose_column, step_reals})
        kernel.set_arg(index++, value);
    }
    if (queues_) {
      unsigned index = 0;
      for (const Buffer* buffer : {rows_.get(), regions_.get(), ints_.get(), queue_.get()})
        still_[parity]->set_arg(index++, *buffer);
      still_[parity]->set_arg(index++, *u[parity]);
      still_[parity]->set_arg(index++, static_cast<std::int32_t>(n_places()));
      still_[parity]->set_arg(index, static_cast<std::int32_t>(parity));
      index = 0;
      for (const Buffer* buffer : arguments()) queued_[parity]->set_arg(index++, *buffer);
      queued_[parity]->set_arg(index++, *queue_);
      queued_[parity]->set_arg(index++, *u[parity]);
      queued_[parity]->set_arg(index, static_cast<std::int32_t>(parity));
    }
    if (keep_ways_[parity])
      keep_ways_[parity]->set_arg(bind_nodes(*keep_ways_[parity], *u[parity]),
                                  static_cast<std::int32_t>(vector_rows_ ? n_rows_ : n_places()));
  }
  set_has_levels(false);
}

void Sliding::set_has_levels(bool has_levels) {
  for (Group& group : groups_)
    for (auto& kernel : group.kernel) kernel->set_arg(kHasLevels, std::int32_t(has_levels));
}

void Sliding::enqueue(int next, std::int32_t step_index, bool keep_normals) {
  if (queues_) {
    still_[next]->enqueue(n_places(), kGroup);
    enqueue_rest(next, keep_normals);
    return;
  }
  for (Group& group : groups_) {
    group.kernel[next]->set_arg(kStepIndex, step_index);
    group.kernel[next]->set_arg(kKeepWays, std::int32_t(keep_normals));
    group.kernel[next]->enqueue(group.n_items, kGroup);
  }
}

void Sliding::enqueue_rest(int next, bool keep_normals) {
  if (queues_) queued_[next]->enqueue(n_groups_ * kQueueGroup, kQueueGroup);
  if (keep_normals) keep_ways_[next]->enqueue(vector_rows_ ? n_rows_ : n_places(), kGroup);
}

std::array<Buffer*, 7> Sliding::known() const {
  return {rows_.get(), regions_.get(),    records_.get(),        heads_.get(),
          ints_.get(), candidates_.get(), candidate_reals_.get()};
}

std::uint8_t Sliding::layout() const { return of_blocks_ && !vector_rows_ ? kTileLayout : kLayout; }

std::vector<std::uint8_t> Sliding::state() const {
  device_.finish();
  std::vector<std::uint8_t> bytes{layout()};
  for (const Buffer* buffer : known()) {
    const std::size_t at = bytes.size();
    bytes.resize(at + buffer->bytes());
    buffer->read(bytes.data() + at, buffer->bytes());
  }
  return bytes;
}

void Sliding::check_state(const std::vector<std::uint8_t>& state) const {
  if (!state.empty() && state.front() != layout())
    throw InputError("state: its sliding nodes are in layout " + std::to_string(state.front()) +
                     ", this version has layout " + std::to_string(layout()) +
                     " on this device; restore with the version and kind of device it was saved "
                     "with, or begin anew");
  std::size_t needed = 1;
  for (const Buffer* buffer : known()) needed += buffer->bytes();
  if (state.size() != needed)
    throw InputError("state: it holds " + std::to_string(state.size()) +
                     " bytes of sliding nodes, this model on this device in this precision has " +
                     std::to_string(needed) +
                     "; restore with the model, precision and device it was saved with");
}

void Sliding::set_state(const std::vector<std::uint8_t>& state) {
  device_.finish();
  const std::uint8_t* at = state.data() + 1;
  for (Buffer* buffer : known()) {
    buffer->write(at, buffer->bytes());
    at += buffer->bytes();
  }
  empty_queue();
}

// Steps come in turns to the two buffers of displacements, and each sets the other's number to 0;
// from where a state is given none waits for either.
void Sliding::empty_queue() {
  const std::int32_t none[SLIDE_WAITING] = {};
  if (queues_) queue_->write(none, sizeof none);
}

void Sliding::forget() {
  const std::size_t lanes = lanes_;
  auto regions = read_reals(*regions_), records = read_reals(*records_);
  auto ints = read_integers(*ints_), heads = read_integers(*heads_);
  for (std::size_t row = 0; row < n_rows_; ++row) {
    heads[row * SLIDE_HEAD + HEAD_SHAPE] &= 1;
    for (const int k : {REGION_ALONG, REGION_ALONG + 1, REGION_ALONG + 2, REGION_ROUND, REGION_ON,
                        REGION_ON + 1, REGION_ON + 2})
      std::fill_n(&regions[(row * REGION_ROWS + k) * lanes], lanes, 0.0);
    for (std::size_t lane = 0; lane < lanes; ++lane) {
      ints[(row * SLIDE_INTS + SLIDE_SHAPE) * lanes + lane] &= 1;
      double* record = &records[(row * lanes + lane) * RECORD_REALS];
      const double surface = record[RECORD_SURFACE];
      std::fill(record + RECORD_NEXT, record + RECORD_REALS, 0.0);
      for (const int k : {RECORD_NEXT, RECORD_ZONE}) record[k] = -1;
      record[RECORD_SURFACE] = surface;
    }
  }
  write_reals(*regions_, regions, precision_);
  write_reals(*records_, records, precision_);
  write_reals(*rows_, unknown_rows(records, lanes), precision_);
  ints_->write(ints.data(), ints.size() * sizeof(std::int32_t));
  heads_->write(heads.data(), heads.size() * sizeof(std::int32_t));
  // A radius of 0: sought at the next step.
  write_reals(*candidate_reals_, std::vector<double>(n_rows_ * lanes * SLIDE_CANDIDATE_REALS, 0.0),
              precision_);
  empty_queue();
}

std::vector<std::int32_t> Sliding::read_integers(const Buffer& buffer) const {
  device_.finish();
  std::vector<std::int32_t> values(buffer.bytes() / sizeof(std::int32_t));
  buffer.read(values.data(), buffer.bytes());
  return values;
}

std::vector<double> Sliding::read_reals(const Buffer& buffer) const {
  device_.finish();
  return tledface::read_reals(buffer, buffer.bytes() / real_size(precision_), precision_);
}

std::vector<double> Sliding::normals() const {
  const std::size_t lanes = lanes_;
  const auto rows = read_reals(*regions_);
  std::vector<double> result(3 * n_nodes_);
  for (std::size_t i = 0; i < n_nodes_; ++i) {
    const std::size_t row = place_[i] / lanes, lane = place_[i] % lanes;
    double length = 0;
    for (int a = 0; a < 3; ++a) {
      const double value = rows[(row * REGION_ROWS + REGION_ALONG + a) * lanes + lane];
      result[3 * i + order_[a]] = value;
      length += value * value;
    }
    for (int a = 0; a < 3 && length > 0; ++a) result[3 * i + a] /= std::sqrt(length);
  }
  return result;
}

std::vector<double> Sliding::friction_losses() const {
  std::vector<double> result(n_nodes_, 0.0);
  if (!has_laws_) return result;
  const std::size_t lanes = lanes_;
  const auto rows = read_reals(*regions_);
  for (std::size_t i = 0; i < n_nodes_; ++i)
    result[i] = rows[(place_[i] / lanes * REGION_ROWS + REGION_LOSS) * lanes + place_[i] % lanes];
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
