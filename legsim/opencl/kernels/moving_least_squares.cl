/* Moving least squares with three control points, without a singular value decomposition, for inclusion in other kernels.

   A point v moves to f(v) = q* + R (v - p*), where p* and q* are the means of the control points at rest and moved, weighted by
   1/|p_j - v|^2, and R is the best rotation between them under these weights (Zhu and Gortler 2007). Three centered points span a plane, so R
   is the rotation that carries the one plane's basis (e1, e2, n) to the other's, after a turn by theta within the plane. Sums
   over centered points are rewritten as sums over the triangle's edges, and multiplied by all squared distances: the weight of the edge
   opposite to point l is then its squared distance d_l^2, nothing is infinite, and

       cos(theta) ~ sum_l d_l^2 C_l,   sin(theta) ~ sum_l d_l^2 S_l,   C_l = A_l . B_l,   S_l = A_l x B_l

   with the edges A_l at rest and B_l moved, both in their plane's basis.

   rest: 18 floats: p_1, p_2, p_3 (m, in the frame that positions are given in), then e1, e2, n of the plane at rest.
   view: 24 floats: H q_1, H q_2, H q_3, H e1', H e2', H n' of the moved plane, then C_1..C_3 and S_1..S_3, where H is any affine map
         of world positions (with the translation for the points, without it for the basis): a projection matrix, or the identity. */

typedef struct {
    float3 weights; /* 1/d_j^2, normalized to the sum 1 */
    float3 squared; /* d_j^2, m^2 */
    float3 arm;     /* v - p* in the basis (e1, e2, n), m */
} mls_point;

/* What depends on the point alone and not on the view: to be kept outside the loop over views. */
mls_point mls_prepare(const float3 position, __constant const float *rest)
{
    mls_point point;
    const float3 a = position - vload3(0, rest), b = position - vload3(1, rest), c = position - vload3(2, rest);
    const float3 squared = (float3)(dot(a, a), dot(b, b), dot(c, c));
    const float3 products = squared.yzx * squared.zxy;
    point.weights = products / (products.x + products.y + products.z);
    point.squared = squared;
    const float3 offset = point.weights.x * a + point.weights.y * b + point.weights.z * c;
    point.arm = (float3)(dot(offset, vload3(3, rest)), dot(offset, vload3(4, rest)), dot(offset, vload3(5, rest)));
    return point;
}

/* H f(v) of one view. */
float3 mls_moved(const mls_point point, __constant const float *view)
{
    const float cosine = dot(point.squared, vload3(6, view)), sine = dot(point.squared, vload3(7, view));
    const float scale = rsqrt(fmax(cosine * cosine + sine * sine, 1e-35f));
    const float along = scale * (cosine * point.arm.x - sine * point.arm.y);
    const float across = scale * (sine * point.arm.x + cosine * point.arm.y);
    return point.weights.x * vload3(0, view) + point.weights.y * vload3(1, view) + point.weights.z * vload3(2, view) +
           along * vload3(3, view) + across * vload3(4, view) + point.arm.z * vload3(5, view);
}
