/* The parameters of the planted registrations, as evalkit_parameters() returns them. */
#ifndef PARAMETERS_H
#define PARAMETERS_H

#define PARAMETERS \
    "epsilon 1e-4 m stop when the error changes by less\n" \
    "max_iterations 40 - largest number of iterations\n" \
    "one_to_one true - of several sources with one target keep the closest\n" \
    "max_correspondence_m 0.3 m largest distance of a pair, 0 for no limit\n" \
    "min_pairs 3 - fewest pairs\n"

#endif
