// The torch-free kernels on NumPy arrays, one instruction set at a time: for tests and benchmarks.
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include "bindings.h"

PYBIND11_MODULE(_kernels, m) {
  m.doc() = "AnyNet's CPU kernels on NumPy arrays, one instruction set at a time.";
  pybind11::enum_<anynet::Isa>(m, "Isa")
      .value(anynet::isa_name(anynet::Isa::baseline), anynet::Isa::baseline)
      .value("avx2", anynet::Isa::avx2)
      .value("avx512", anynet::Isa::avx512);
  m.def("isa_available", &anynet::isa_available);
  m.def("chosen_isa", &anynet::chosen_isa);
  for (const auto bind : anynet::bindings::Binding::all()) bind(m);
}
