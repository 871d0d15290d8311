// How physkin_core._native takes arrays and objects of Python: checked, viewed or copied. What is wrong is thrown as
// std::invalid_argument, which is a ValueError in Python.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <cstdlib>
#include <initializer_list>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "evaluator/garment_evaluator.hpp"
#include "garment/bound_garment.hpp"
#include "kernels/dispatch.hpp"

namespace physkin {

namespace nb = nanobind;

using AnyArray = nb::ndarray<nb::ro, nb::device::cpu>;
// A float64, read-only or strided array would be converted into a copy that nobody reads; every use is noconvert.
using OutputArray = nb::ndarray<float, nb::ndim<2>, nb::device::cpu>;
using RowArray = nb::ndarray<const float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Floats = nb::ndarray<const float, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using WrittenFloats = nb::ndarray<float, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

inline std::string shape_text(const std::vector<int>& shape) {
  std::string text;
  for (int size : shape) text += (text.empty() ? "" : ", ") + (size < 0 ? "any" : std::to_string(size));
  return "(" + text + (shape.size() == 1 ? ",)" : ")");
}

// Refuses an array of another shape.
template <class Array>
void check_shape(const Array& array, const char* name, std::initializer_list<int> shape) {
  bool good = array.ndim() == shape.size();
  for (std::size_t axis = 0; good && axis < shape.size(); ++axis) {
    good = array.shape(axis) == std::size_t(shape.begin()[axis]);
  }
  if (!good) throw std::invalid_argument(std::string(name) + " must have shape " + shape_text(shape));
}

// Views one array of the garment: dtype T, C-contiguous. A negative size in `shape` allows any and is filled in.
template <class T>
const T* view(nb::handle object, const std::string& name, std::vector<int>& shape) {
  AnyArray array;
  bool good = nb::try_cast(object, array, false) && array.dtype() == nb::dtype<T>() && array.ndim() == shape.size();
  const std::vector<int> wanted = shape;
  std::int64_t stride = 1;
  for (std::size_t axis = good ? shape.size() : 0; axis-- > 0;) {
    shape[axis] = int(array.shape(axis));
    good = good && (wanted[axis] < 0 || wanted[axis] == shape[axis]);
    good = good && (array.size() == 0 || shape[axis] == 1 || array.stride(axis) == stride);
    stride *= shape[axis];
  }
  if (!good) {
    throw std::invalid_argument(name + " must be a C-contiguous " + (std::is_same_v<T, float> ? "float32" : "int32") +
                                " array of shape " + shape_text(wanted));
  }
  return static_cast<const T*>(array.data());
}

// A layer's network weights and bias, named `matrix` and `bias` in errors.
inline DenseWeights dense_weights(nb::handle matrix_array, const std::string& matrix, nb::handle bias_array,
                                  const std::string& bias) {
  std::vector<int> shape{-1, -1};
  const float* weights = view<float>(matrix_array, matrix, shape);
  std::vector<int> outputs{shape[0]};
  return {shape[0], shape[1], weights, view<float>(bias_array, bias, outputs)};
}

// The same, or a projection, whose bias is empty.
inline DenseWeights layer_or_projection(nb::handle matrix_array, nb::handle bias_array, const std::string& at) {
  std::vector<int> shape{-1, -1};
  const float* weights = view<float>(matrix_array, at + " network weights", shape);
  if (shape[0] > 0 && nb::len(bias_array) == 0) return {shape[0], shape[1], weights, nullptr};
  return dense_weights(matrix_array, at + " network weights", bias_array, at + " bias");
}

// Reads the fields of Python objects under the interpreter's lock, for as long as it lives; they are used without it.
// Network weights are viewed and kept alive, so that it must be destroyed under the lock, too. Everything else is
// copied: an index must not change between its check and its use.
class PythonReader : public FieldSource {
 public:
  BoundGarment bound_garment(nb::handle object) {
    object_ = object;
    return read_bound_garment(*this);
  }
  SkinningData skinning_data(nb::handle object) {
    object_ = object;
    return read_skinning_data(*this, nb::cast<std::int64_t>(attribute("detail_node_count")));
  }
  // For whatever else reads its fields by name.
  FieldSource& fields_of(nb::handle object) {
    object_ = object;
    return *this;
  }

  const float* floats(const std::string& name, std::vector<int>& shape) override { return copied<float>(name, shape); }
  const std::int32_t* integers(const std::string& name, std::vector<int>& shape) override {
    return copied<std::int32_t>(name, shape);
  }
  std::vector<DenseWeights> layers(const std::string& name) override {
    std::vector<DenseWeights> layers;
    for (nb::handle layer : attribute(name)) {
      const std::string at = name + "[" + std::to_string(layers.size()) + "]";
      layers.push_back(layer_or_projection(held(layer[0]), held(layer[1]), at));
    }
    return layers;
  }

 private:
  nb::object attribute(const std::string& name) const { return object_.attr(name.c_str()); }
  nb::handle held(nb::object object) { return held_.emplace_back(std::move(object)); }

  template <class T>
  const T* copied(const std::string& name, std::vector<int>& shape) {
    const nb::object array = attribute(name);
    const T* values = view<T>(array, name, shape);
    std::size_t count = 1;
    for (int size : shape) count *= std::size_t(size);
    return arena_.copy(values, count);
  }

  nb::handle object_;
  Arena arena_;
  std::vector<nb::object> held_;
};

inline int checked_garment(int garment, int count) {
  if (garment < 0 || garment >= count) {
    throw std::out_of_range("garment " + std::to_string(garment) + " of " + std::to_string(count));
  }
  return garment;
}

inline void raise_if(const char* wrong) {
  if (wrong != nullptr) throw std::invalid_argument(wrong);
}
inline void raise_if(const Rejection& rejection) {
  if (rejection) throw std::invalid_argument(rejection.message());
}

// An array of float32 that vertices are written to; strides in floats.
struct Output {
  void* data;
  std::int64_t rows, columns, row_stride, column_stride;
};

inline VertexRows vertex_rows(const Output& out, int vertex_count) {
  if (out.rows != vertex_count || (out.columns != 3 && out.columns != 6)) {
    throw std::invalid_argument("out has shape " + shape_text({int(out.rows), int(out.columns)}) + "; expected " +
                                shape_text({vertex_count, 3}) + " or " + shape_text({vertex_count, 6}));
  }
  if (out.column_stride != 1)
    throw std::invalid_argument("a row of out must be contiguous; rows may be any distance apart");
  if (vertex_count > 1 && std::abs(out.row_stride) < out.columns) {
    throw std::invalid_argument("rows of out overlap: they are " + std::to_string(out.row_stride) + " floats apart");
  }
  return {static_cast<unsigned char*>(out.data), std::ptrdiff_t(out.row_stride), out.columns == 6};
}

inline VertexRows vertex_rows(const OutputArray& out, int vertex_count) {
  const Output output{out.data(), std::int64_t(out.shape(0)), std::int64_t(out.shape(1)), out.stride(0), out.stride(1)};
  return vertex_rows(output, vertex_count);
}

using Text = std::optional<std::string>;  // None: from the environment, or the default

}  // namespace physkin
