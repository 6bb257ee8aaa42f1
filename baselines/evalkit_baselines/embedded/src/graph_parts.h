/* graph_parts.h - parts of pose_graph.h that pose_graph.c and graph_matrix.c share. */
#ifndef EK_GRAPH_PARTS_H
#define EK_GRAPH_PARTS_H

#include "ek/pose_graph.h"

#define EK_NODE_WORK 12u /* operations for a step: its residual, its covariance, its move */

#define ek_graph_linearise EK_NAME(graph_linearise)
#define ek_graph_multiply EK_NAME(graph_multiply)
#define ek_graph_factor EK_NAME(graph_factor)
#define ek_graph_substitute_back EK_NAME(graph_substitute_back)

/* Number of blocks in a lower triangle of so many rows. */
static inline size_t ek_graph_triangle(size_t rows)
{
    return rows * (rows + 1u) / 2u;
}

/* Residual of an edge; `inverse` becomes the matrix from residuals to twists of the world about `origin`, row-major. It
 * is the inverse of the derivative by the difference of the twists of both poses. */
void ek_graph_linearise(ek_pose first, ek_pose second, ek_pose measured, ek_pose origin, ek_real residual[3],
                        ek_real inverse[9]);

/* Product of a 3 x 3 matrix and a vector. */
void ek_graph_multiply(const ek_real matrix[9], const ek_real v[3], ek_real product[3]);

/* Phase EK_SOLVER_MATRIX: factor the matrix of the dual problem by rows, and substitute forward. One block has at most 4
 * operations for each loop, and one pass of a row one more. */
void ek_graph_factor(ek_pose_graph *graph, ek_work *work);

/* Phase EK_SOLVER_BACK: substitute backward by rows; the pull of the loops on the steps takes the residuals' place. */
void ek_graph_substitute_back(ek_pose_graph *graph, ek_work *work);

#endif
