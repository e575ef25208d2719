"""Numba loops, grouped by what they loop over."""

import numba

# Expressions that stand next to each other in the source, as the components of a vector do, become
# vector instructions. Compilers of other languages have this on; numba has had it off since LLVM 14
# was found to err.
numba.config.SLP_VECTORIZE = 1
