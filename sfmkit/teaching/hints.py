"""Hints in two levels: the first gives the idea, the second the formula or the call."""

from __future__ import annotations

__all__ = ["HINTS"]

HINTS: dict[str, tuple[str, str]] = {
    "00.1": (
        "Half of the width, the focal length and half of the field of view form a right triangle.",
        "The field of view is 2 arctan(w / (2 f)); np.degrees converts radians.",
    ),
    "00.2": (
        "All lengths of the cloud have the same unit.",
        "Multiply the depth by the length of the baseline in metres.",
    ),
    "00.3": (
        "Each stage of the run keeps a part of what the stage before it found.",
        "A point is triangulated from an inlier; an inlier is a match of two keypoints.",
    ),
    "01.1": (
        "Compute two boolean arrays, one for brighter and one for darker pixels, and search a "
        "run of nine in each. The ring is closed.",
        "Append the first eight pixels of the ring to its end; then a run does not cross the end.",
    ),
    "01.2": (
        "Both terms are functions of the matrix that NumPy has.",
        "np.linalg.det(A) and np.trace(A).",
    ),
    "01.3": (
        "Start with the rectangle from the origin to (x1, y1) and subtract the parts outside the "
        "box.",
        "The part that is subtracted twice must be added once: S[y0, x0]. Rows are indexed by y.",
    ),
    "01.4": (
        "The centroid is the mean of the positions, weighted by the intensities. Only its "
        "direction is needed.",
        "np.arctan2(sum of y * patch, sum of x * patch), with x and y relative to the centre.",
    ),
    "02.1": (
        "The bits that differ are the bits that are set in the exclusive or.",
        "np.unpackbits(a ^ b).sum()",
    ),
    "02.2": (
        "Find the nearest column of each row and the nearest row of each column; keep the "
        "pairs that are nearest to each other.",
        "With n = D.argmin(1) and m = D.argmin(0), row i is kept if m[n[i]] == i.",
    ),
    "02.3": (
        "Sort the distances.",
        "Divide the first sorted distance by the second one.",
    ),
    "03.1": (
        "Use homogeneous coordinates.",
        "Compute y = H (x, y, 1) and divide its first two coordinates by the third one.",
    ),
    "03.2": (
        "A pixel of image 2 is first mapped to image 1.",
        "The matrix that is applied first is the factor on the right: H13 inv(H12).",
    ),
    "03.3": (
        "Convert the pixel to a ray, rotate the ray, and project it.",
        "inv(K) converts a pixel to a ray; K projects a ray.",
    ),
    "03.4": (
        "Count the degrees of freedom of H and the equations that one match gives.",
        "H has eight degrees of freedom; a match gives two equations.",
    ),
    "04.1": (
        "The line consists of all x2 with x2^T F x1 = 0.",
        "The line is F (x, y, 1).",
    ),
    "04.2": (
        "The value a x + b y + c is proportional to the distance. What is it for a normal vector "
        "(a, b) of length one?",
        "Divide |a x + b y + c| by sqrt(a² + b²).",
    ),
    "04.3": (
        "Insert x1 = K1 xn1 and x2 = K2 xn2 into x2^T F x1 = 0.",
        "(K2 xn2)^T = xn2^T K2^T; the product between xn2^T and xn1 is E.",
    ),
    "04.4": (
        "Start with nine entries. Which two properties of F reduce the number?",
        "The scale of F is arbitrary, and its determinant is zero.",
    ),
    "05.1": (
        "The centre of camera 2 is the origin of its own frame.",
        "Solve 0 = R c + t for c; the inverse of R is its transpose.",
    ),
    "05.2": (
        "E = [t]x R, where [t]x is the matrix of the cross product with t.",
        "[t]x has the rows (0, -tz, ty), (tz, 0, -tx), (-ty, tx, 0).",
    ),
    "05.3": (
        "Test the depth of every point in each of the two camera frames.",
        "The rows of X @ R.T + t are the points in the frame of camera 2.",
    ),
    "05.4": (
        "Imagine a model of the scene at half the size.",
        "If all points and the translation are multiplied by a number, the pixels do not change.",
    ),
    "05.5": (
        "In image 2, the match of X is the image of X + s.",
        "X2 = R (X + s) + t = R X + (t + R s).",
    ),
    "06.1": (
        "Use similar triangles: the baseline at the depth z, the disparity at the focal length.",
        "b / z = d / f.",
    ),
    "06.2": (
        "First-order error propagation multiplies sigma by the derivative of z with respect to d.",
        "|dz / dd| = f b / d²; replace d by f b / z.",
    ),
    "06.3": (
        "Find a and b for which the two points on the rays are closest: a least-squares "
        "problem with two unknowns.",
        "Solve [d1, -d2] (a, b) = c2 - c1 with np.linalg.lstsq.",
    ),
    "06.4": (
        "The scalar product of unit vectors is the cosine of the angle.",
        "Divide the scalar product by both lengths before np.arccos.",
    ),
    "07.1": (
        "Central means symmetric about x.",
        "The difference of f at x + h and x - h, divided by the distance between them.",
    ),
    "07.2": (
        "Minimise |r + J s|² with respect to the step s.",
        "The normal equations are J^T J s = -J^T r.",
    ),
    "07.3": (
        "The covariance of the residuals is sigma² times the identity.",
        "The covariance is sigma² times the inverse of J^T J.",
    ),
    "07.4": (
        "Two parts are independent of each other. Which part is contained in another one?",
        "The variances of the image regions and of the cameras add up; take the square root.",
    ),
    "08.1": (
        "What does a single run with the error e contribute to the area?",
        "It contributes 1 - e / threshold if that is positive, else 0; take the mean.",
    ),
    "08.2": (
        "The scores are paired, so use the difference of each pair.",
        "Divide the standard deviation of the differences by the square root of their number.",
    ),
    "08.3": (
        "Average the gain of an operator over both orders in which the two can be added.",
        "Operator 1 gains v1 if it is added first, and v12 - v2 if it is added second.",
    ),
    "08.4": (
        "How many comparisons are there? What share of them is below 0.05 by chance?",
        "31 combinations have 31 · 30 / 2 pairs.",
    ),
    "09.1": (
        "The ratio of the focal length to the diagonal is the same in millimetres and in pixels.",
        "The diagonals are np.hypot(36, 24) mm and np.hypot(w, h) pixels.",
    ),
    "09.2": (
        "The focal lengths are multiplied by s. The corner of the image, not the centre of the "
        "first pixel, stays in place.",
        "The corner is at -0.5: the principal point becomes (c + 0.5) s - 0.5.",
    ),
    "09.3": (
        "Which pair has no baseline?",
        "Without a translation both rays of a point coincide.",
    ),
    "10.1": (
        "What is the probability that all N samples contain an outlier?",
        "Solve (1 - w^s)^N <= 1 - p for N and round up with math.ceil.",
    ),
    "10.2": (
        "A line is orthogonal to the homogeneous coordinates of each of its points.",
        "The cross product of (x, y, 1) of both points.",
    ),
    "10.3": (
        "Divide by the length of the normal vector (A, B), and take absolute values.",
        "|x @ l[:2] + l[2]| / np.hypot(l[0], l[1]) <= threshold",
    ),
    "10.4": (
        "Divide |x2^T F x1| by the norm of its gradient with respect to the four coordinates.",
        "The gradient has the first two entries of F x1 and the first two of F^T x2.",
    ),
    "11.1": (
        "Each query compares itself with all keys; the result is a weighted mean of the values.",
        "Compute S = Q K^T / sqrt(d), apply the softmax to each row, and multiply by V.",
    ),
    "11.2": (
        "This is the cross-check of notebook 02 for scores, with a lower limit.",
        "With j = P.argmax(1), row i is kept if P.argmax(0)[j[i]] == i and P[i, j[i]] >= least.",
    ),
    "11.3": (
        "Where do the corners (0, 0) and (w - 1, 0) of the first row go?",
        "The first row becomes the last column, from top to bottom.",
    ),
    "11.4": (
        "Weight each measurement by its information, the inverse of its variance.",
        "The information of independent measurements adds up: 1 / sigma^2 = sum of 1 / s^2.",
    ),
}
