"""What of the machine is used: cores, memory, LLVM, files, signals, and how long things take."""
