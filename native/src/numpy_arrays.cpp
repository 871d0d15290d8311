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

}  // namespace

const Numpy& Numpy::get() {
  static const Numpy* numpy = new Numpy(looked_up());  // outlives the interpreter, which must not be asked for it then
  return *numpy;
}

}  // namespace physkin
