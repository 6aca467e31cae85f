# No function of one instruction set may be merged by the linker with another's, or with the rest of the program: every
# weak function (template or inline) of an object must lie in its instruction set's namespace. (nm cannot read all of the
# compilers' names.)
#   cmake -DNM=nm -DISA=avx2 -DOBJECTS="a.o;b.o" -P instruction_set_leaks.cmake
foreach(object IN LISTS OBJECTS)
  execute_process(COMMAND ${NM} -C --defined-only ${object} OUTPUT_VARIABLE symbols RESULT_VARIABLE failed)
  if(failed)
    message(FATAL_ERROR "${NM} cannot read ${object}")
  endif()
  string(REPLACE "\n" ";" symbols "${symbols}")
  foreach(symbol IN LISTS symbols)
    if(symbol MATCHES "^[0-9a-f]* W " AND NOT symbol MATCHES "anynet::${ISA}::|_Z+N6anynet[0-9]${ISA}[0-9]|__clang_call_terminate")
      message(SEND_ERROR "${object}: ${symbol}")
    endif()
  endforeach()
endforeach()
