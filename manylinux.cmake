# A cross compiler for Linux with glibc 2.28, by `make wheels`: the processor is $MACHINE, and $ZIG is Zig's program.
set(CMAKE_SYSTEM_NAME Linux)
set(CMAKE_SYSTEM_PROCESSOR $ENV{MACHINE})
set(CMAKE_CXX_COMPILER $ENV{ZIG} c++ -target $ENV{MACHINE}-linux-gnu.2.28)
set(CMAKE_CXX_ARCHIVE_CREATE "$ENV{ZIG} ar qc <TARGET> <OBJECTS>")
set(CMAKE_CXX_ARCHIVE_FINISH "$ENV{ZIG} ranlib <TARGET>")
set(CMAKE_CXX_FLAGS_INIT "-include cstdio")  # nanobind with the stable ABI prints by it without including it
