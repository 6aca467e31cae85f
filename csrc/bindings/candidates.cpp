#include "../kernels/candidates/candidates.h"

#include "bindings.h"

namespace anynet::bindings {
namespace {

void bind_candidates(pybind11::module_& m) {
  m.def("candidate_costs", [](Isa isa, const Contiguous<float>& features, const Contiguous<float>& disparity,
                              int64_t groups, int64_t first, int64_t last, int64_t radius, int threads) {
    const int64_t channels = features.shape(1), height = features.shape(2), width = features.shape(3),
                  count = last - first + 1;
    Contiguous<float> out({int64_t{1}, groups * (count + 2) + channels + 2, height, width});
    const CandidateCosts<float> args{channels,         groups, height, width,  features.data(),
                                     disparity.data(), first,  count,  radius, out.mutable_data()};
    anynet::candidate_costs(isa, args, threads);
    return out;
  });
  m.def("expected_disparity", [](Isa isa, const Contiguous<float>& cost, const Contiguous<float>& disparity,
                                 const Contiguous<float>& offsets, int64_t first, int threads) {
    Contiguous<float> out = empty_like<float>(disparity);
    const ExpectedDisparity<float> args{cost.shape(1),  disparity.size(),          cost.data(),       disparity.data(),
                                        offsets.data(), static_cast<float>(first), out.mutable_data()};
    anynet::expected_disparity(isa, args, threads);
    return out;
  });
}

const Binding binding(bind_candidates);

}  // namespace
}  // namespace anynet::bindings
