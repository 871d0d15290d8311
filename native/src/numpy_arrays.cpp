#include "numpy_arrays.hpp"

namespace physkin {
namespace {

Numpy looked_up() {
  const nb::module_ module = nb::module_::import_("numpy");
  const nb::object dtype = module.attr("dtype");
  Numpy numpy{module.attr("ndarray"), dtype("float32"), dtype("float64"), module.attr("empty"), module.attr("asarray")};
  const nb::object rows = numpy.empty(nb::make_tuple(2, 3), numpy.float32);
  const NumpyArray* array = numpy.view(rows);
  const nb::object address = rows.attr("__array_interface__")["data"][0];
  if (reinterpret_cast<std::size_t>(array->data) != nb::cast<std::size_t>(address) || array->ndim != 2 ||
      array->shape[0] != 2 || array->shape[1] != 3 || array->strides[0] != 12 || array->strides[1] != 4 ||
      !array->is_writable() || !array->dtype->is('f')) {
    throw std::runtime_error("arrays of this NumPy do not begin as its documentation says: take another version");
  }
  return numpy;
}

std::optional<Output> output_of(const NumpyArray* array) {
  if (array == nullptr || array->ndim != 2 || !array->dtype->is('f') || !array->is_writable()) return std::nullopt;
  const Py_ssize_t rows = array->strides[0], columns = array->strides[1], size = sizeof(float);
  if (rows % size != 0 || columns % size != 0) return std::nullopt;
  return Output{array->data, array->shape[0], array->shape[1], rows / size, columns / size};
}

std::string described(nb::handle out) {
  const auto text = [](nb::object of) { return std::string(nb::str(nb::handle(of)).c_str()); };
  const NumpyArray* array = Numpy::get().view(out);
  if (array == nullptr) return text(out.type().attr("__name__"));
  return (array->is_writable() ? "" : "read-only ") + text(out.attr("dtype")) + " of shape " + text(out.attr("shape"));
}

}  // namespace

const Numpy& Numpy::get() {
  static const Numpy* numpy = new Numpy(looked_up());  // outlives the interpreter, which must not be asked for it then
  return *numpy;
}

VertexRows given_rows(nb::handle out, int vertex_count, std::vector<OutputArray>& held) {
  if (const auto output = output_of(Numpy::get().view(out))) return vertex_rows(*output, vertex_count);
  OutputArray other;
  if (nb::try_cast(out, other, false)) return vertex_rows(held.emplace_back(std::move(other)), vertex_count);
  throw nb::type_error(("out must be a writable float32 array of two dimensions, got " + described(out)).c_str());
}

}  // namespace physkin
