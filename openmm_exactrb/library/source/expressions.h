// Derivatives of the energies of OpenMM's custom forces as sequences of simple operations.
#ifndef EXACTRB_EXPRESSIONS_H_
#define EXACTRB_EXPRESSIONS_H_

#include <string>

namespace exactrb {

// Return the steps that compute the derivative of an energy with respect to a variable, one in each line: "variable NAME",
// "constant VALUE", or the name of an operation in operations.cl, its number, and the steps whose results are its
// arguments. The result of the last step is the derivative. Steps with equal results are a single step. An exception is
// thrown for functions other than those of OpenMM.
std::string derivative(const std::string& energy, const std::string& variable);

} // namespace exactrb
#endif
