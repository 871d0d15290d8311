// The part of physkin_core._native that reads joint values: checks and converts, computes nothing.
#include <string>
#include <utility>
#include <vector>

#include "bindings.hpp"
#include "joints/joint_reading.hpp"
#include "python_arrays.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace physkin {
namespace {

template <class Values>
void check_size(const Values& values, const char* name, std::size_t wanted) {
  if (values.size() != wanted)
    throw std::invalid_argument(std::string(name) + " must have shape " + shape_text({int(wanted)}));
}

// Arrays were checked once: a message converts and allocates nothing. Keeps them alive.
class BoundReading {
 public:
  BoundReading(const std::vector<int>& source, const std::vector<int>& target, const std::vector<double>& scale,
               const std::vector<double>& offset, std::size_t first, bool swapped, double farthest, Floats start,
               WrittenFloats out)
      : start_(std::move(start)),
        out_(std::move(out)),
        reading_(taken(source, target, scale, offset), first, swapped, farthest, out_.size()) {
    check_size(start_, "start", out_.size());
  }

  bool read(const nb::bytes& message) {
    return reading_.read(static_cast<const unsigned char*>(message.data()), message.size(), start_.data(), out_.data());
  }

 private:
  std::vector<TakenJoint> taken(const std::vector<int>& source, const std::vector<int>& target,
                                const std::vector<double>& scale, const std::vector<double>& offset) const {
    check_size(target, "target", source.size());
    check_size(scale, "scale", source.size());
    check_size(offset, "offset", source.size());
    std::vector<TakenJoint> joints;
    for (std::size_t k = 0; k < source.size(); ++k) {
      if (source[k] < 0 || target[k] < 0 || std::size_t(target[k]) >= out_.size()) {
        throw std::invalid_argument("joint " + std::to_string(k) + " is taken from value " + std::to_string(source[k]) +
                                    " to position " + std::to_string(target[k]) + " of " + std::to_string(out_.size()));
      }
      joints.push_back({source[k], target[k], scale[k], offset[k]});
    }
    return joints;
  }

  Floats start_;
  WrittenFloats out_;
  JointReading reading_;
};

class BoundRange {
 public:
  BoundRange(Floats positions, WrittenFloats least, WrittenFloats most)
      : positions_(std::move(positions)), least_(std::move(least)), most_(std::move(most)) {
    check_size(least_, "least", positions_.size());
    check_size(most_, "most", positions_.size());
  }

  void widen() { physkin::widen(positions_.data(), least_.data(), most_.data(), positions_.size()); }

 private:
  Floats positions_;
  WrittenFloats least_, most_;
};

class Beginning {
 public:
  Beginning(const nb::bytes& pattern, const nb::bytes& mask)
      : pattern_(pattern.c_str(), pattern.size()), mask_(mask.c_str(), mask.size()) {
    if (pattern.size() != mask.size()) throw std::invalid_argument("pattern and mask must be of one length");
  }

  bool matches(const nb::bytes& message) const {
    const auto bytes = [](const std::string& text) { return reinterpret_cast<const unsigned char*>(text.data()); };
    return begins_with(static_cast<const unsigned char*>(message.data()), message.size(), bytes(pattern_), bytes(mask_),
                       pattern_.size());
  }

 private:
  std::string pattern_, mask_;
};

}  // namespace

void bind_joints(nb::module_& module) {
  nb::class_<BoundReading>(module, "JointReading")
      .def(nb::init<const std::vector<int>&, const std::vector<int>&, const std::vector<double>&,
                    const std::vector<double>&, std::size_t, bool, double, Floats, WrittenFloats>(),
           "source"_a, "target"_a, "scale"_a, "offset"_a, "first"_a, "swapped"_a, "farthest"_a, "start"_a.noconvert(),
           "out"_a.noconvert())
      .def("read", &BoundReading::read, "message"_a);
  nb::class_<BoundRange>(module, "PoseRange")
      .def(nb::init<Floats, WrittenFloats, WrittenFloats>(), "positions"_a.noconvert(), "least"_a.noconvert(),
           "most"_a.noconvert())
      .def("widen", &BoundRange::widen);
  nb::class_<Beginning>(module, "MessageBeginning")
      .def(nb::init<const nb::bytes&, const nb::bytes&>(), "pattern"_a, "mask"_a)
      .def("matches", &Beginning::matches, "message"_a);
}

}  // namespace physkin
