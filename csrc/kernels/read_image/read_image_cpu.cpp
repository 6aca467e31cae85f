#include "../common/parallel.h"
#include "reader.h"

namespace anynet::ANYNET_ISA {

template <class T>
void read_image(const ReadImage<T>& a, int threads) {
  const Reader<T> reader(a);
  parallel_for(a.height, useful_threads(threads, a.height, a.block, a.block, a.width, 8),
               [&](int64_t y) { reader.row(y, a.out + y * a.width, a.height * a.width); });
}

template void read_image<float>(const ReadImage<float>&, int);

}  // namespace anynet::ANYNET_ISA
