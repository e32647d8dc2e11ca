#include "sim/nodal_conditions.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <string>

#include "core/error.hpp"
#include "precompute/layout.hpp"

namespace tledface {
namespace {

// Work-items a group; on the native device, a reason to deal them out in chunks.
constexpr std::size_t kGroup = 64;
constexpr std::size_t kShapeReals = 6;  // PRESSURE_SHAPE_REALS of kernels_cl/conditions.cl
// Where the kernels take the index of the step in the table, and the key.
constexpr unsigned kLoadsStepIndex = 9, kPressureStepIndex = 11, kPrescribeStepIndex = 6,
                   kFieldsStepIndex = 6;

std::array<double, 3> difference(const double* a, const double* b) {
  return {a[0] - b[0], a[1] - b[1], a[2] - b[2]};
}

std::array<double, 3> cross(const std::array<double, 3>& a, const std::array<double, 3>& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

}  // namespace

NodalConditions::NodalConditions(Conditions conditions, const VoxelModel& model,
                                 const SolverArrays& arrays, Device& device, Program& program,
                                 Precision precision, std::int32_t first_column, std::size_t batch)
    : given_(std::move(conditions)),
      model_(model),
      arrays_(arrays),
      device_(device),
      precision_(precision),
      first_column_(first_column) {
  const auto& order = arrays.order;
  const bool even = (order[1] - order[0] + 3) % 3 == 1;
  area_sign_ = even ? -0.125 : 0.125;
  const auto indices = [&](const std::vector<std::int64_t>& dofs) {
    std::vector<std::int32_t> result(dofs.size());
    std::transform(dofs.begin(), dofs.end(), result.begin(),
                   [&](std::int64_t dof) { return dof_index(dof); });
    return result;
  };
  const auto make = [&](const char* name, std::unique_ptr<Kernel>(&kernels)[2]) {
    for (auto& kernel : kernels) kernel = program.kernel(name);
  };
  if (!given_.prescribed_dofs.empty()) {
    prescribed_dofs_ = integers(indices(given_.prescribed_dofs));
    std::vector<std::int32_t> columns = given_.prescribed_channels;
    for (auto& column : columns) column += first_column_ + given_.n_loads + given_.n_pressures;
    prescribed_columns_ = integers(columns);
    make("prescribe_values", prescribe_);
  }
  if (!given_.field_dofs.empty()) {
    field_dofs_ = integers(indices(given_.field_dofs));
    keys_ = reals(std::vector<double>((batch / kFieldStride + 2) * n_fields(), 0.0));
    make("prescribe_fields", fields_);
  }
  if (!given_.load_dofs.empty()) {
    make_loads();
    make("apply_loads", loads_);
  }
  if (!given_.pressure_faces.empty()) {
    make_pressures();
    make("apply_pressure", pressure_);
  }
}

std::unique_ptr<Buffer> NodalConditions::reals(const std::vector<double>& values) {
  const std::size_t bytes = values.size() * real_size(precision_);
  auto buffer = device_.allocate(bytes);
  bytes_ += bytes;
  if (precision_ == Precision::kDouble) {
    buffer->write(values.data(), bytes);
  } else {
    const std::vector<float> narrow(values.begin(), values.end());
    buffer->write(narrow.data(), bytes);
  }
  return buffer;
}

std::unique_ptr<Buffer> NodalConditions::integers(const std::vector<std::int32_t>& values) {
  auto buffer = device_.allocate(values.size() * sizeof(std::int32_t));
  bytes_ += buffer->bytes();
  buffer->write(values.data(), values.size() * sizeof(std::int32_t));
  return buffer;
}

std::int32_t NodalConditions::dof_index(std::int64_t dof) const {
  if (dof < 0 || dof >= static_cast<std::int64_t>(3 * arrays_.node_slot.size()))
    throw InputError("conditions: degree of freedom " + std::to_string(dof) + " does not exist");
  const std::int64_t slot = arrays_.node_slot[dof / 3], lanes = arrays_.lanes;
  const auto& order = arrays_.order;
  const std::int64_t component =
      std::find(order.begin(), order.end(), static_cast<int>(dof % 3)) - order.begin();
  return static_cast<std::int32_t>((slot / lanes * 3 + component) * lanes + slot % lanes);
}

void NodalConditions::make_loads() {
  // dof -> its entries, in the order given.
  std::map<std::int32_t, std::vector<std::size_t>> entries_of;
  for (std::size_t i = 0; i < given_.load_dofs.size(); ++i)
    entries_of[dof_index(given_.load_dofs[i])].push_back(i);
  std::vector<std::int32_t> dofs, begin{0}, columns;
  std::vector<double> forces;
  for (const auto& [dof, entries] : entries_of) {
    dofs.push_back(dof);
    for (const std::size_t i : entries) {
      columns.push_back(first_column_ + given_.load_channels[i]);
      forces.push_back(given_.load_forces[i]);
    }
    begin.push_back(static_cast<std::int32_t>(columns.size()));
  }
  n_load_dofs_ = static_cast<std::int32_t>(dofs.size());
  load_dofs_ = integers(dofs);
  load_begin_ = integers(begin);
  load_columns_ = integers(columns);
  load_forces_ = reals(forces);
}

void NodalConditions::make_pressures() {
  const std::size_t n_faces = given_.pressure_channels.size();
  const auto& order = arrays_.order;
  std::map<std::array<double, kShapeReals>, std::int32_t> shape_index;
  std::vector<double> shapes;
  std::map<std::int32_t, std::vector<std::int32_t>> faces_of;  // x dof -> faces
  std::vector<std::int32_t> faces;
  for (std::size_t f = 0; f < n_faces; ++f) {
    const std::int32_t* nodes = &given_.pressure_faces[4 * f];
    std::array<double, kShapeReals> shape;
    for (int a = 0; a < 3; ++a)
      for (const int diagonal : {0, 1})
        shape[3 * diagonal + a] = model_.way(nodes[diagonal], nodes[diagonal + 2])[order[a]];
    const auto [it, is_new] =
        shape_index.emplace(shape, static_cast<std::int32_t>(shape_index.size()));
    if (is_new) shapes.insert(shapes.end(), shape.begin(), shape.end());
    for (int corner = 0; corner < 4; ++corner) {
      const std::int32_t dof = dof_index(3 * std::int64_t(nodes[corner]) + order[0]);
      faces.push_back(dof);
      faces_of[dof].push_back(static_cast<std::int32_t>(f));
    }
    faces.push_back(first_column_ + given_.n_loads + given_.pressure_channels[f]);
    faces.push_back(it->second);
  }
  std::vector<std::int32_t> dofs, begin{0}, node_faces;
  for (const auto& [dof, list] : faces_of) {
    dofs.push_back(dof);
    node_faces.insert(node_faces.end(), list.begin(), list.end());
    begin.push_back(static_cast<std::int32_t>(node_faces.size()));
  }
  n_pressure_nodes_ = static_cast<std::int32_t>(dofs.size());
  pressure_dofs_ = integers(dofs);
  pressure_begin_ = integers(begin);
  pressure_node_faces_ = integers(node_faces);
  faces_ = integers(faces);
  face_shapes_ = reals(shapes);
}

void NodalConditions::bind(const Buffer* const (&u)[2], const Buffer& blocks,
                           const Buffer& node_sets, const Buffer& step_table,
                           std::int32_t step_reals) {
  const auto set = [](Kernel& kernel, std::initializer_list<const Buffer*> buffers,
                      std::initializer_list<std::int32_t> values) {
    unsigned index = 0;
    for (const Buffer* buffer : buffers) kernel.set_arg(index++, *buffer);
    for (const std::int32_t value : values) kernel.set_arg(index++, value);
  };
  for (int parity = 0; parity < 2; ++parity) {
    const Buffer *now = u[parity], *next = u[1 - parity];
    if (loads_[parity])
      set(*loads_[parity],
          {next, &blocks, &node_sets, load_dofs_.get(), load_begin_.get(), load_columns_.get(),
           load_forces_.get(), &step_table},
          {n_load_dofs_, 0, step_reals});
    if (pressure_[parity])
      set(*pressure_[parity],
          {now, next, &blocks, &node_sets, pressure_dofs_.get(), pressure_begin_.get(),
           pressure_node_faces_.get(), faces_.get(), face_shapes_.get(), &step_table},
          {n_pressure_nodes_, 0, step_reals});
    if (prescribe_[parity])
      set(*prescribe_[parity],
          {next, &blocks, prescribed_dofs_.get(), prescribed_columns_.get(), &step_table},
          {static_cast<std::int32_t>(given_.prescribed_dofs.size()), 0, step_reals});
    if (fields_[parity])
      set(*fields_[parity], {next, &blocks, field_dofs_.get(), keys_.get(), &step_table},
          {static_cast<std::int32_t>(n_fields()), 0, step_reals,
           first_column_ + given_.n_values()});
  }
}

bool NodalConditions::any_acts_on(const std::vector<std::int64_t>& nodes) const {
  std::vector<bool> acts(model_.n_nodes(), false);
  for (const auto* dofs : {&given_.prescribed_dofs, &given_.field_dofs, &given_.load_dofs})
    for (const std::int64_t dof : *dofs) acts[dof / 3] = true;
  for (const std::int32_t node : given_.pressure_faces) acts[node] = true;
  return std::any_of(nodes.begin(), nodes.end(), [&](std::int64_t node) { return acts[node]; });
}

void NodalConditions::fill_columns(const double* values, FieldMoment field, double* columns) const {
  std::copy_n(values, given_.n_values(), columns);
  for (std::int32_t i = 0; i < given_.n_pressures; ++i) columns[given_.n_loads + i] *= area_sign_;
  if (!n_fields()) return;
  columns[given_.n_values()] = field.weight;
  columns[given_.n_values() + 1] = static_cast<double>(field.key);
}

void NodalConditions::write_keys(const double* keys, std::size_t count) {
  const std::size_t values = count * n_fields(), bytes = values * real_size(precision_);
  if (bytes > keys_->bytes())
    throw InputError("conditions: " + std::to_string(count) +
                     " keys are more than there is room for");
  if (precision_ == Precision::kDouble) {
    keys_->write_later(keys, bytes);
  } else {
    const std::vector<float> narrow(keys, keys + values);
    keys_->write_later(narrow.data(), bytes);
  }
}

void NodalConditions::enqueue(int parity, std::int32_t step_index) {
  const auto go = [&](Kernel& kernel, unsigned index, std::size_t n) {
    kernel.set_arg(index, step_index);
    kernel.enqueue(n, kGroup);
  };
  if (loads_[parity]) go(*loads_[parity], kLoadsStepIndex, n_load_dofs_);
  if (pressure_[parity]) go(*pressure_[parity], kPressureStepIndex, n_pressure_nodes_);
  if (prescribe_[parity])
    go(*prescribe_[parity], kPrescribeStepIndex, given_.prescribed_dofs.size());
  if (fields_[parity]) go(*fields_[parity], kFieldsStepIndex, n_fields());
}

std::vector<double> NodalConditions::force(const std::vector<double>& u,
                                           const double* values) const {
  std::vector<double> force(u.size(), 0.0);
  for (std::size_t i = 0; i < given_.load_dofs.size(); ++i)
    force[given_.load_dofs[i]] += values[given_.load_channels[i]] * given_.load_forces[i];
  for (std::size_t f = 0; f < given_.pressure_channels.size(); ++f) {
    const std::int32_t* nodes = &given_.pressure_faces[4 * f];
    double x[4][3];
    for (int corner = 0; corner < 4; ++corner) {
      const auto at = model_.position(nodes[corner]);
      for (int c = 0; c < 3; ++c) x[corner][c] = at[c] + u[3 * nodes[corner] + c];
    }
    const auto area = cross(difference(x[2], x[0]), difference(x[3], x[1]));
    const double p = -values[given_.n_loads + given_.pressure_channels[f]] / 8;
    for (int corner = 0; corner < 4; ++corner)
      for (int c = 0; c < 3; ++c) force[3 * nodes[corner] + c] += p * area[c];
  }
  return force;
}

}  // namespace tledface
