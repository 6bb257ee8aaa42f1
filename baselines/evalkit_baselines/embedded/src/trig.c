/* Sine, cosine and arc tangent from additions, multiplications and divisions alone: with -ffp-contract=off they give the
 * same bits on every processor with IEEE 754 arithmetic. The results of C libraries differ in their last bits.
 * Coefficients and split constants: fdlibm (Sun Microsystems 1993, freely distributable) for double, Cephes (Moshier
 * 1992, freely distributable) for float. */
#include "ek/real.h"

#ifdef EK_FLOAT
#define REMAINDER fmodf
#define TURN EK_R(6.2831855)
#define LARGEST EK_R(8192.0) /* rad: up to here multiples of the first two parts are exact */
static const ek_real right_angle[3] = {1.5703125f, 4.837512969970703125e-4f, 7.54978995489188216e-8f};
static const ek_real half_turn[2] = {3.1415927410f, -8.7422776573e-8f};
static const ek_real sine_terms[] = {-1.6666654611e-1f, 8.3321608736e-3f, -1.9515295891e-4f};
static const ek_real cosine_terms[] = {4.166664568298827e-2f, -1.388731625493765e-3f, 2.443315711809948e-5f};
static const ek_real tangent_terms[] = {-3.33329491539e-1f, 1.99777106478e-1f, -1.38776856032e-1f, 8.05374449538e-2f};
static const ek_real half_arc[2] = {0.46364760399f, 5.0121582440e-9f};
#else
#define REMAINDER fmod
#define TURN EK_R(6.283185307179586)
#define LARGEST EK_R(1e5)
static const ek_real right_angle[3] = {1.57079632673412561417, 6.07710050630396597660e-11, 2.02226624879595063154e-21};
static const ek_real half_turn[2] = {3.14159265358979311600, 1.22464679914735317636e-16};
static const ek_real sine_terms[] = {-1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04,
                                     2.75573137070700676789e-06, -2.50507602534068634195e-08, 1.58969099521155010221e-10};
static const ek_real cosine_terms[] = {4.16666666666666019037e-02,  -1.38888888888741095749e-03, 2.48015872894767294178e-05,
                                       -2.75573143513906633035e-07, 2.08757232129817482790e-09,  -1.13596475577881948265e-11};
static const ek_real tangent_terms[] = {
    -3.33333333333329318027e-01, 1.99999999998764832476e-01,  -1.42857142725034663711e-01, 1.11111104054623557880e-01,
    -9.09088713343650656196e-02, 7.69187620504482999495e-02,  -6.66107313738753120669e-02, 5.83357013379057348645e-02,
    -4.97687799461593236017e-02, 3.65315727442169155270e-02,  -1.62858201153657823623e-02};
static const ek_real half_arc[2] = {4.63647609000806093515e-01, 2.26987774529616870924e-17};
#endif

#define COUNT(terms) (sizeof(terms) / sizeof *(terms))

static ek_real polynomial(const ek_real *terms, size_t count, ek_real z)
{
    ek_real sum = terms[count - 1u];
    for (size_t k = count - 1u; k-- > 0u;) {
        sum = terms[k] + z * sum;
    }
    return sum;
}

/* The sine of an angle of `quarters` right angles and a rest of at most pi / 4 (its second part is what rounding lost).
 */
static ek_real sine_of(ek_real quarters, ek_real rest, ek_real lost)
{
    const ek_real turn = quarters - EK_R(4.0) * EK_FLOOR(EK_R(0.25) * quarters), z = rest * rest;
    ek_real value;
    if (turn == EK_R(1.0) || turn == EK_R(3.0)) {
        const ek_real half = EK_R(0.5) * z, near = EK_R(1.0) - half;
        value = near + (((EK_R(1.0) - near) - half) + (z * z * polynomial(cosine_terms, COUNT(cosine_terms), z) - rest * lost));
    } else {
        value = rest + (lost + rest * z * polynomial(sine_terms, COUNT(sine_terms), z));
    }
    return turn >= EK_R(2.0) ? -value : value;
}

/* The sine of an angle plus `quarters` right angles. */
static ek_real sine_after(ek_real angle, ek_real quarters)
{
    const ek_real near = EK_FABS(angle) <= LARGEST ? angle : REMAINDER(angle, TURN);
    const ek_real count = EK_FLOOR(near / (right_angle[0] + right_angle[1]) + EK_R(0.5));
    const ek_real first = near - count * right_angle[0], second = first - count * right_angle[1];
    const ek_real rest = second - count * right_angle[2];
    const ek_real lost = ((first - second) - count * right_angle[1]) + ((second - rest) - count * right_angle[2]);
    return sine_of(count + quarters, rest, lost);
}

ek_real EK_NAME(sin)(ek_real angle)
{
    return sine_after(angle, EK_R(0.0));
}

ek_real EK_NAME(cos)(ek_real angle)
{
    return sine_after(angle, EK_R(1.0));
}

/* The angle of the direction (x, y), both not negative and y <= x, to the x axis. */
static ek_real flat_angle(ek_real y, ek_real x)
{
    ek_real ratio, base = EK_R(0.0), lost = EK_R(0.0);
    if (y > EK_R(0.6875) * x) { /* from pi / 4 */
        ratio = (y - x) / (y + x);
        base = EK_R(0.25) * half_turn[0];
        lost = EK_R(0.25) * half_turn[1];
    } else if (y > EK_R(0.375) * x) { /* from the arc tangent of 1 / 2 */
        ratio = (EK_R(2.0) * y - x) / (EK_R(2.0) * x + y);
        base = half_arc[0];
        lost = half_arc[1];
    } else {
        ratio = x > EK_R(0.0) ? y / x : EK_R(0.0);
    }
    const ek_real z = ratio * ratio;
    return base + (ratio + (lost + ratio * z * polynomial(tangent_terms, COUNT(tangent_terms), z)));
}

ek_real EK_NAME(atan2)(ek_real y, ek_real x)
{
    const ek_real up = EK_FABS(y), across = EK_FABS(x);
    ek_real angle = up > across ? EK_R(0.5) * half_turn[0] - (flat_angle(across, up) - EK_R(0.5) * half_turn[1])
                                : flat_angle(up, across);
    if (signbit(x)) {
        angle = half_turn[0] - (angle - half_turn[1]);
    }
    return signbit(y) ? -angle : angle;
}
