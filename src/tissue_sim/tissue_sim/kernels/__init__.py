"""Numba loops, grouped by what they loop over."""

import numba

# Expressions that stand next to each other in the source (the components of a vector, several
# right-hand sides) become vector instructions: two to six times fewer for block rows. Compilers of
# other languages have this on; numba has had it off since LLVM 14 was found to err.
numba.config.SLP_VECTORIZE = 1
