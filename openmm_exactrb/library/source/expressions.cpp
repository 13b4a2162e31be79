// Energies are read and differentiated by OpenMM's own parser, Lepton, so that kernels compute what OpenMM computes.
#include "expressions.h"
#include "machine.h"
#include "lepton/ExpressionTreeNode.h"
#include "lepton/Operation.h"
#include "lepton/ParsedExpression.h"
#include "lepton/Parser.h"
#include <locale>
#include <sstream>

using Lepton::ExpressionTreeNode;
using Lepton::Operation;
using std::string;
using std::vector;

namespace exactrb {
namespace {

const vector<string> NAMES = {
#define OPERATION(name, value) #name,
#include "multiple_time_steps/operations.cl"
#undef OPERATION
};
// The largest integer power that is a product.
const int LARGEST_PRODUCT = 64;

class Steps {
public:
    string text;

    // Add the steps of a node and of its children, and return the index of the last step.
    int add(const ExpressionTreeNode& node) {
        vector<int> of;
        for (const ExpressionTreeNode& child : node.getChildren())
            of.push_back(add(child));
        const Operation& o = node.getOperation();
        switch (o.getId()) {
        case Operation::CONSTANT: return constant(dynamic_cast<const Operation::Constant&>(o).getValue());
        case Operation::VARIABLE: return line("variable " + o.getName());
        case Operation::ADD: return step("add", of);
        case Operation::SUBTRACT: return step("subtract", of);
        case Operation::MULTIPLY: return step("multiply", of);
        case Operation::DIVIDE: return step("divide", of);
        case Operation::POWER: return step("power", of);
        case Operation::NEGATE: return step("subtract", {constant(0.0), of[0]});
        case Operation::SEC: return inverse(step("cos", of));
        case Operation::CSC: return inverse(step("sin", of));
        case Operation::COT: return inverse(step("tan", of));
        case Operation::SQUARE: return power(of[0], 2);
        case Operation::CUBE: return power(of[0], 3);
        case Operation::RECIPROCAL: return inverse(of[0]);
        case Operation::ADD_CONSTANT: return step("add", {of[0], constant(dynamic_cast<const Operation::AddConstant&>(o).getValue())});
        case Operation::MULTIPLY_CONSTANT: return step("multiply", {of[0], constant(dynamic_cast<const Operation::MultiplyConstant&>(o).getValue())});
        case Operation::POWER_CONSTANT: return power(of[0], dynamic_cast<const Operation::PowerConstant&>(o).getValue());
        default: return step(o.getName(), of);
        }
    }

private:
    int step(const string& name, const vector<int>& arguments) {
        const auto found = std::find(NAMES.begin(), NAMES.end(), name);
        if (found == NAMES.end())
            throw error("there is no kernel of the function " + name);
        string made = name + " " + std::to_string(found-NAMES.begin());
        for (int i = 0; i < 3; i++)
            made += " " + std::to_string(i < (int) arguments.size() ? arguments[i] : 0);
        return line(made);
    }
    int constant(double value) {
        std::ostringstream words;  // independent of the locale, unlike printf
        words.imbue(std::locale::classic());
        words.precision(17);
        words << "constant " << value;
        return line(words.str());
    }
    int inverse(int of) {
        return step("divide", {constant(1.0), of});
    }
    // Integer powers are products, as in Lepton.
    int power(int base, double exponent) {
        int n = exponent >= -LARGEST_PRODUCT && exponent <= LARGEST_PRODUCT ? (int) exponent : 0;
        if (n != exponent)
            return step("power", {base, constant(exponent)});
        if (n < 0)
            base = inverse(base), n = -n;
        int result = -1;
        for (; n > 0; n /= 2) {
            if (n % 2)
                result = result < 0 ? base : step("multiply", {result, base});
            if (n > 1)
                base = step("multiply", {base, base});
        }
        return result < 0 ? constant(1.0) : result;
    }
    int line(const string& made) {
        const auto inserted = places.emplace(made, (int) places.size());
        if (inserted.second)
            text += made + "\n";
        return inserted.first->second;
    }
    std::map<string, int> places;
};

} // namespace

string derivative(const string& energy, const string& variable) {
    Steps steps;
    steps.add(Lepton::Parser::parse(energy).differentiate(variable).optimize().getRootNode());
    return steps.text;
}

} // namespace exactrb
