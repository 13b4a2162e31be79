    // The derivative of the energy of the terms of a custom force from term t on, and zero for repeated terms. It is computed
    // by the steps of an expression, each for AT_ONCE terms.
    enum {
#define OPERATION(name, value) OF_##name,
#include "multiple_time_steps/operations.cl"
#undef OPERATION
    };
    std::vector<double> room_of_steps;
    several derivative(int force, const several& coordinate, int t, const Terms& terms, const double* numbers, const int* customs,
            const double* values, const double* parameters) {
        const int count = customs[CUSTOM_ROW*force+STEPS];
        const int* step = customs+STEPS_OF_CUSTOMS+STEP_ROW*customs[CUSTOM_ROW*force+FIRST_STEP];
        double *made = sized(room_of_steps, AT_ONCE*count), *result = made;
        for (int k = 0; k < count; k++, step += STEP_ROW, result += AT_ONCE) {
            switch (step[0]) {
            case COORDINATE:
                EACH(l, AT_ONCE)
                    result[l] = LANE(coordinate, l);
                break;
            case NUMBER_OF_TERM:
                EACH(l, AT_ONCE)
                    result[l] = numbers[step[1]*terms.count+std::min(t+l, terms.last-1)];
                break;
            case PARAMETER:
            case CONSTANT:
                EACH(l, AT_ONCE)
                    result[l] = (step[0] == PARAMETER ? parameters : values)[step[1]];
                break;
#define OPERATION(name, value) \
            case FIRST_OPERATION+OF_##name: \
                EACH(l, AT_ONCE) { \
                    const double a = made[AT_ONCE*step[1]+l], b = made[AT_ONCE*step[2]+l], c = made[AT_ONCE*step[3]+l]; \
                    (void) b, (void) c; \
                    result[l] = value; \
                } \
                break;
#include "multiple_time_steps/operations.cl"
#undef OPERATION
            }
        }
        several found = {};
        for (int l = 0; l < std::min(AT_ONCE, terms.last-t); l++)
            LANE(found, l) = made[AT_ONCE*(count-1)+l];
        return found;
    }
