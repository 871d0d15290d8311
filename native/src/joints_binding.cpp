// The part of physkin_core._native that reads joint values: checks and converts, computes nothing.
#include "joints_binding.hpp"

#include <nanobind/ndarray.h>
#include <nanobind/stl/vector.h>

#include <string>
#include <utility>
#include <vector>

#include "joints/joint_reading.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace physkin {
namespace {

using Given = nb::ndarray<const float, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Written = nb::ndarray<float, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

void check_size(std::size_t size, const char* name, std::size_t wanted) {
  if (size != wanted)
    throw nb::value_error((std::string(name) + " must have shape (" + std::to_string(wanted) + ",)").c_str());
}

// Arrays were checked once: a message converts and allocates nothing. Keeps them alive.
class BoundReading {
 public:
  BoundReading(const std::vector<int>& source, const std::vector<int>& target, const std::vector<double>& scale,
               const std::vector<double>& offset, std::size_t first, bool swapped, double farthest, Given start,
               Written out)
      : start_(std::move(start)),
        out_(std::move(out)),
        reading_(taken(source, target, scale, offset), first, swapped, farthest, out_.size()) {
    check_size(start_.size(), "start", out_.size());
  }

  bool read(const nb::bytes& message) {
    return reading_.read(static_cast<const unsigned char*>(message.data()), message.size(), start_.data(), out_.data());
  }

 private:
  std::vector<TakenJoint> taken(const std::vector<int>& source, const std::vector<int>& target,
                                const std::vector<double>& scale, const std::vector<double>& offset) const {
    check_size(target.size(), "target", source.size());
    check_size(scale.size(), "scale", source.size());
    check_size(offset.size(), "offset", source.size());
    std::vector<TakenJoint> joints;
    for (std::size_t k = 0; k < source.size(); ++k) {
      if (source[k] < 0 || target[k] < 0 || std::size_t(target[k]) >= out_.size()) {
        throw nb::value_error(("joint " + std::to_string(k) + " is taken from value " + std::to_string(source[k]) +
                               " to position " + std::to_string(target[k]) + " of " + std::to_string(out_.size()))
                                  .c_str());
      }
      joints.push_back({source[k], target[k], scale[k], offset[k]});
    }
    return joints;
  }

  Given start_;
  Written out_;
  JointReading reading_;
};

class BoundRange {
 public:
  BoundRange(Given positions, Written least, Written most)
      : positions_(std::move(positions)), least_(std::move(least)), most_(std::move(most)) {
    check_size(least_.size(), "least", positions_.size());
    check_size(most_.size(), "most", positions_.size());
  }

  void widen() { physkin::widen(positions_.data(), least_.data(), most_.data(), positions_.size()); }

 private:
  Given positions_;
  Written least_, most_;
};

class Beginning {
 public:
  Beginning(const nb::bytes& pattern, const nb::bytes& mask)
      : pattern_(pattern.c_str(), pattern.size()), mask_(mask.c_str(), mask.size()) {
    if (pattern.size() != mask.size()) throw nb::value_error("pattern and mask must be of one length");
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
                    const std::vector<double>&, std::size_t, bool, double, Given, Written>(),
           "source"_a, "target"_a, "scale"_a, "offset"_a, "first"_a, "swapped"_a, "farthest"_a, "start"_a.noconvert(),
           "out"_a.noconvert())
      .def("read", &BoundReading::read, "message"_a);
  nb::class_<BoundRange>(module, "PoseRange")
      .def(nb::init<Given, Written, Written>(), "positions"_a.noconvert(), "least"_a.noconvert(), "most"_a.noconvert())
      .def("widen", &BoundRange::widen);
  nb::class_<Beginning>(module, "MessageBeginning")
      .def(nb::init<const nb::bytes&, const nb::bytes&>(), "pattern"_a, "mask"_a)
      .def("matches", &Beginning::matches, "message"_a);
}

}  // namespace physkin
