// The scheduler of the emulator. Compiled without ThreadSanitizer's instrumentation: it moves between fibers that the
// sanitizer is to treat as unsynchronized threads, and tells it so.
#include <ucontext.h>

#include <algorithm>
#include <atomic>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "cuda_runtime.h"

#ifdef EMULATOR_ASAN
#include <sanitizer/common_interface_defs.h>
#endif
#ifdef EMULATOR_TSAN
#include <sanitizer/tsan_interface.h>
#endif

namespace emulator {
namespace {

constexpr size_t stack_bytes = 128 * 1024;
constexpr unsigned warp_size = 32;

struct Barrier {
  unsigned arrived = 0;
  unsigned generation = 0;
  char sync[2];  // what ThreadSanitizer is told about, in turn, so that neighboring generations stay apart
};

/// What a fiber needs that is costly to make: kept from launch to launch.
struct Stack {
  std::unique_ptr<char[]> memory{new char[stack_bytes]};
#ifdef EMULATOR_TSAN
  void* tsan = __tsan_create_fiber(0);
#endif
};

struct Fiber {
  ucontext_t context;
  Stack* stack = nullptr;
  dim3 thread;
  unsigned index = 0;
  bool done = false;
};

struct Warp {
  Barrier barrier;
  std::vector<char> slots;
};

struct SharedArray {
  std::unique_ptr<char[]> data;
  size_t bytes;
};

struct Machine {
  const std::function<void()>* thread;
  dim3 size, block;
  unsigned count;
  size_t shared_bytes, shared_used;
  ucontext_t scheduler;
  Barrier barrier;
  std::vector<Fiber> fibers;
  std::vector<Warp> warps;
  std::vector<SharedArray> shared;
  std::vector<SharedArray> spent;  // arrays of earlier blocks, freed at the end: their addresses are not reused
  Fiber* current = nullptr;
  std::string error;
#ifdef EMULATOR_ASAN
  void* fake_stack = nullptr;
  const void* main_stack = nullptr;
  size_t main_stack_bytes = 0;
#endif
#ifdef EMULATOR_TSAN
  void* tsan = nullptr;
  char begin, end;  // for ThreadSanitizer: threads start after the launch began, and it ends after all of them
#endif
};

thread_local Machine* machine = nullptr;
std::atomic<int64_t> launched{0};

void to_fiber(Fiber& fiber) {
  machine->current = &fiber;
#ifdef EMULATOR_ASAN
  __sanitizer_start_switch_fiber(&machine->fake_stack, fiber.stack->memory.get(), stack_bytes);
#endif
#ifdef EMULATOR_TSAN
  __tsan_switch_to_fiber(fiber.stack->tsan, __tsan_switch_to_fiber_no_sync);
#endif
  swapcontext(&machine->scheduler, &fiber.context);
#ifdef EMULATOR_ASAN
  __sanitizer_finish_switch_fiber(machine->fake_stack, nullptr, nullptr);
#endif
}

void to_scheduler() {
  Fiber& fiber = *machine->current;
#ifdef EMULATOR_ASAN
  void* fake_stack = nullptr;
  __sanitizer_start_switch_fiber(fiber.done ? nullptr : &fake_stack, machine->main_stack, machine->main_stack_bytes);
#endif
#ifdef EMULATOR_TSAN
  __tsan_switch_to_fiber(machine->tsan, __tsan_switch_to_fiber_no_sync);
#endif
  swapcontext(&fiber.context, &machine->scheduler);
#ifdef EMULATOR_ASAN
  __sanitizer_finish_switch_fiber(fake_stack, &machine->main_stack, &machine->main_stack_bytes);
#endif
}

void fiber_main() {
#ifdef EMULATOR_ASAN
  __sanitizer_finish_switch_fiber(nullptr, &machine->main_stack, &machine->main_stack_bytes);
#endif
#ifdef EMULATOR_TSAN
  __tsan_acquire(&machine->begin);
#endif
  (*machine->thread)();
#ifdef EMULATOR_TSAN
  __tsan_release(&machine->end);
#endif
  machine->current->done = true;
  to_scheduler();
}

void wait(Barrier& barrier, unsigned expected) {
  const unsigned generation = barrier.generation;
  char* sync = &barrier.sync[generation % 2];
#ifdef EMULATOR_TSAN
  __tsan_release(sync);
#endif
  if (++barrier.arrived == expected) {
    barrier.arrived = 0;
    ++barrier.generation;
  } else {
    while (barrier.generation == generation) to_scheduler();
  }
#ifdef EMULATOR_TSAN
  __tsan_acquire(sync);
#else
  (void)sync;
#endif
}

/// Something that changes whenever any thread gets past a barrier or ends.
uint64_t progress() {
  uint64_t total = machine->barrier.generation;
  for (const Warp& warp : machine->warps) total += warp.barrier.generation;
  for (const Fiber& fiber : machine->fibers) total += fiber.done;
  return total;
}

void run_block() {
  for (Fiber& fiber : machine->fibers) {
    fiber.done = false;
    getcontext(&fiber.context);
    fiber.context.uc_stack.ss_sp = fiber.stack->memory.get();
    fiber.context.uc_stack.ss_size = stack_bytes;
    fiber.context.uc_link = nullptr;
    makecontext(&fiber.context, fiber_main, 0);
  }
  machine->barrier.arrived = 0;
  for (Warp& warp : machine->warps) warp.barrier.arrived = 0;
  machine->shared_used = 0;
  unsigned left = machine->count;
  for (bool forward = true; left > 0; forward = !forward) {
    const uint64_t before = progress();
    for (unsigned i = 0; i < machine->count; ++i) {
      Fiber& fiber = machine->fibers[forward ? i : machine->count - 1 - i];
      if (fiber.done) continue;
      to_fiber(fiber);
      if (fiber.done) --left;
      if (!machine->error.empty()) throw std::runtime_error(machine->error);
    }
    if (left > 0 && progress() == before) {
      throw std::runtime_error("emulator: " + std::to_string(left) + " of " + std::to_string(machine->count) +
                               " threads wait at a barrier that the others never reach");
    }
  }
  for (SharedArray& array : machine->shared) machine->spent.push_back(std::move(array));
  machine->shared.clear();
}

}  // namespace

int64_t launches() { return launched; }

dim3 thread_index() { return machine->current->thread; }
dim3 block_index() { return machine->block; }
dim3 block_size() { return machine->size; }

void block_barrier() { wait(machine->barrier, machine->count); }

void exchange(const void* mine, size_t bytes, void* all) {
  const unsigned index = machine->current->index, lane = index % warp_size;
  const unsigned lanes = std::min(warp_size, machine->count - index / warp_size * warp_size);
  Warp& warp = machine->warps[index / warp_size];
  memcpy(warp.slots.data() + lane * bytes, mine, bytes);
  wait(warp.barrier, lanes);
  memcpy(all, warp.slots.data(), warp_size * bytes);
  wait(warp.barrier, lanes);
}

void* shared_array(int index, size_t bytes) {
  if (static_cast<size_t>(index) == machine->shared.size()) {
    machine->shared_used += (bytes + 15) / 16 * 16;
    if (machine->shared_used > machine->shared_bytes) {
      machine->error = "emulator: the kernel takes " + std::to_string(machine->shared_used) +
                       " bytes of shared memory, the launch gives " + std::to_string(machine->shared_bytes);
      to_scheduler();
    }
    // Not initialized, as on a GPU: what a kernel reads before writing is garbage.
    machine->shared.push_back({std::unique_ptr<char[]>(new char[bytes]), bytes});
    memset(machine->shared.back().data.get(), 0xff, bytes);
#ifdef EMULATOR_TSAN
    __tsan_release(machine->shared.back().data.get());
#endif
  }
  SharedArray& array = machine->shared.at(index);
#ifdef EMULATOR_TSAN
  __tsan_acquire(array.data.get());
#endif
  if (array.bytes != bytes) machine->error = "emulator: threads take different arrays of shared memory";
  return array.data.get();
}

void run(dim3 grid, dim3 block, size_t shared_bytes, const std::function<void()>& thread) {
  ++launched;
  static thread_local std::vector<std::unique_ptr<Stack>> stacks;
  Machine here;
  here.thread = &thread;
  here.size = block;
  here.count = block.x * block.y * block.z;
  here.shared_bytes = shared_bytes;
  if (here.count == 0 || here.count > 1024) throw std::runtime_error("emulator: a block has 1 to 1024 threads");
  if (shared_bytes > 227 * 1024) throw std::runtime_error("emulator: a block has at most 227 KiB of shared memory");
  here.warps.resize((here.count + warp_size - 1) / warp_size);
  for (Warp& warp : here.warps) warp.slots.resize(warp_size * 16);
  here.fibers.resize(here.count);
  while (stacks.size() < here.count) stacks.push_back(std::make_unique<Stack>());
  machine = &here;
#ifdef EMULATOR_TSAN
  here.tsan = __tsan_get_current_fiber();
  __tsan_release(&here.begin);
#endif
  for (unsigned i = 0; i < here.count; ++i) {
    Fiber& fiber = here.fibers[i];
    fiber.index = i;
    fiber.thread = dim3(i % block.x, i / block.x % block.y, i / (block.x * block.y));
    fiber.stack = stacks[i].get();
  }
  const auto finish = [&] {
#ifdef EMULATOR_TSAN
    __tsan_acquire(&here.end);
#endif
    machine = nullptr;
  };
  try {
    for (here.block.z = 0; here.block.z < grid.z; ++here.block.z) {
      for (here.block.y = 0; here.block.y < grid.y; ++here.block.y) {
        for (here.block.x = 0; here.block.x < grid.x; ++here.block.x) run_block();
      }
    }
  } catch (...) {
    finish();
    throw;
  }
  finish();
}

}  // namespace emulator
