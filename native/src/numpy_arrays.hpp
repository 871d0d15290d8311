// Arrays of NumPy, read where they lie. In a program that drapes at 60 Hz a frame finds little in the processor's caches,
// and to ask for an array by DLPack or the buffer protocol then takes 5 to 10 us. Its head takes none to speak of: NumPy
// documents how arrays and their dtypes begin (C-API: PyArrayObject, PyArray_Descr).
#pragma once

#include <nanobind/nanobind.h>

#include <cstddef>
#include <cstring>
#include <stdexcept>
#include <string>
#include <vector>

#include "python_arrays.hpp"

namespace physkin {

namespace nb = nanobind;

// The beginning of PyArray_Descr.
struct NumpyDtype {
  PyObject head;
  PyTypeObject* scalar;
  char kind, type, byte_order;

  bool is(char wanted) const { return type == wanted && byte_order == '='; }
};

// The beginning of PyArrayObject.
struct NumpyArray {
  PyObject head;
  char* data;
  int ndim;
  const Py_ssize_t *shape, *strides;  // strides in bytes
  PyObject* base;
  const NumpyDtype* dtype;
  int flags;

  bool is_writable() const { return (flags & 0x0400) != 0; }
};

// What of NumPy is needed again and again; looked up once, and kept until the process ends.
struct Numpy {
  nb::object array_type, float32, float64, empty, asarray;

  // Throws std::runtime_error if arrays do not begin as documented. The first call is made when the module is imported.
  static const Numpy& get();

  // The array that this object is; null if it is none.
  const NumpyArray* view(nb::handle object) const {
    return PyObject_TypeCheck(object.ptr(), reinterpret_cast<PyTypeObject*>(array_type.ptr()))
               ? reinterpret_cast<const NumpyArray*>(object.ptr())
               : nullptr;
  }
};

// Reads `size` numbers of an array (size,) of float32 or float64. False, and nothing read, if it is anything else.
template <class T>
bool read_row(nb::handle given, std::size_t size, T* out) {
  const NumpyArray* array = Numpy::get().view(given);
  if (array == nullptr || array->ndim != 1 || std::size_t(array->shape[0]) != size) return false;
  const auto read = [&](auto number) {
    for (std::size_t k = 0; k < size; ++k) {
      std::memcpy(&number, array->data + std::ptrdiff_t(k) * array->strides[0], sizeof(number));
      out[k] = T(number);
    }
    return true;
  };
  return array->dtype->is('f') ? read(float()) : array->dtype->is('d') && read(double());
}

// N numbers in any form in which Python gives them; errors name what was given.
template <std::size_t N>
class GivenNumbers {
 public:
  // Converts to false if they are not N.
  explicit GivenNumbers(nb::handle given) : given_(given), good_(read_row(given, N, values_)) {
    if (!good_) good_ = read_row(array(), N, values_);
  }
  // Throws std::invalid_argument if they are not N.
  GivenNumbers(nb::handle given, const char* name) : GivenNumbers(given) {
    if (good_) return;
    const nb::object shape = array().attr("shape");
    if (nb::len(shape) > 1) {
      throw std::invalid_argument(std::string("gravity, wind and roots are rows of numbers, got an array of shape ") +
                                  nb::repr(shape).c_str());
    }
    raise(std::string(name) + " must have shape (" + std::to_string(N) + ",)");
  }

  explicit operator bool() const { return good_; }
  const double* data() const { return values_; }

  // Throws std::invalid_argument.
  [[noreturn]] void raise(const std::string& wrong) const {
    throw std::invalid_argument(wrong + ", got " + nb::repr(array().attr("tolist")()).c_str());
  }
  // wrong: null if nothing is.
  void raise_if(const char* wrong) const {
    if (wrong != nullptr) raise(wrong);
  }

 private:
  nb::object array() const { return Numpy::get().asarray(given_, Numpy::get().float64); }

  nb::handle given_;
  double values_[N] = {};
  bool good_;
};

// The rows of an array that `vertex_count` vertices are written to. Throws nb::type_error for anything but a writable
// array of float32 of two dimensions, and as `vertex_rows` does. held: keeps alive what is no array of NumPy.
VertexRows given_rows(nb::handle out, int vertex_count, std::vector<OutputArray>& held);

}  // namespace physkin
