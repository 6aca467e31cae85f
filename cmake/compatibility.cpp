// What newer compilers' headers take from a libstdc++ (3.4.25 and later) or glibc (2.29 and later) that systems which
// AnyNet's wheels are for (manylinux_2_28) do not have. Defined here, it is not asked of the system. Weak: a compiler
// that has libstdc++ as an archive only links that one's own besides.
#include <new>
#include <sstream>

#ifdef __GLIBCXX__

template std::ostringstream::basic_ostringstream();
template std::stringstream::basic_stringstream();

namespace std {
[[gnu::weak]] void __throw_bad_array_new_length();  // GCC 11
void __throw_bad_array_new_length() { throw std::bad_array_new_length(); }
}  // namespace std

extern "C" char __libc_single_threaded;  // glibc 2.32: whether reference counts may do without atomics
char __libc_single_threaded = 0;

#endif
