// Alignment of a frame with the picture of the ball: the attitude that explains the contrast of most pixels, and the
// shift of its centre.
//
// Gauss-Newton on SO(3) over the pixels where the picture changes within a pixel (Lucas and Kanade 1981; Baker and
// Matthews 2004, "Lucas-Kanade 20 years on"), with the weights of Geman and McClure (1987, "Statistical methods for
// tomographic image reconstruction"). A hand covers whole areas, and the picture fits some of its pixels by chance. So
// the weight of a pixel also falls with those of its neighbours. The error of a pixel has the image noise, and a part
// that grows with the gradient: interpolation, blur, and the picture's own errors.
#include <numeric>

#include "spheremouse/ball/texture/picture.h"
#include "spheremouse/geometry/rotation.h"

namespace spheremouse::ball {
namespace {

constexpr int MOST = 6000;      // independent pixels: the contrasts of neighbours are means of the same grey values
constexpr int MOST_ROUNDS = 6;  // with some samples, and with all
constexpr float YOUNG = 3.0f;   // views: the place of a cell with few follows the frames that taught it
constexpr double NEAR = 2e-4;   // rad: a thirtieth of a pixel on a ball of 350 px; one step with all samples goes on
constexpr double NEAR_SQUARED = 0.1;  // of a step over its covariance: a third of a standard deviation is near, too
constexpr int SHIFT_ROUNDS = 3;       // with a shift of the centre
constexpr double SINGULAR = 1e-9;     // share of all information, about an axis that no pixel shows
constexpr size_t FEW = 2000;          // samples of which some show the way
constexpr size_t MEDIAN_OF = 2000;    // residuals: their scale has a standard deviation of 2 %
constexpr float FAR = 3.8f;           // standard deviations: 95 % efficiency for normal errors
constexpr int MOST_ANCHORS = 1 << 12;
constexpr float SMOOTH = 0.1f;  // variance of a slope by noise over that of two pixels: means of pixels are smooth

/// The residuals' model.
struct Errors {
    float noise;  // of a contrast
    float place;  // rad, of the picture's contours
    float angle;  // rad: a pixel counts if it shows a rotation by so much
};

/// The shares of the pixels in a tile of the picture.
struct TileShare {
    float sum = 0.0f, count = 0.0f;

    void add(float share) { sum += share, count += 1.0f; }
    float mean() const { return sum / count; }
};

/// The pixels that count, against the picture, in columns.
class Residuals {
    size_t size_ = 0;  // the columns may be longer

  public:
    std::vector<float> z, value, contrast, variance;
    std::vector<float> square;            // z² / variance
    std::vector<float> by_x, by_y, by_z;  // of the picture's value by a rotation of the ball, in axes of the ball
    std::vector<float> feigned;           // variance of these by errors of the picture, per axis across the direction
    std::vector<float> share, weight;     // of Geman and McClure's: 0 to 1; by variance
    std::vector<float> mild;              // weight by the root of the share: for the correlation
    std::vector<int> tile;                // of the picture
    std::vector<int> pixel;               // its number

    size_t size() const { return size_; }
    void clear() { size_ = 0; }
    void make_room(size_t n);
    void add(const Look& seen, const float* contrast, const Errors& errors, size_t first);
    float scale() const;
    void weigh(float scale);
    void weigh_tiles(std::vector<TileShare>& tiles);
};

void Residuals::make_room(size_t n) {
    if (tile.size() >= n) return;
    for (auto* column : {&tile, &pixel}) column->resize(n);
    for (auto* column :
         {&z, &value, &contrast, &variance, &square, &by_x, &by_y, &by_z, &feigned, &share, &weight, &mild})
        column->resize(n);
}

/// Add the residuals of pixels, from the `first` on, that the picture knows, where it changes. There is room for all.
WIDE void Residuals::add(const Look& seen, const float* contrasts, const Errors& errors, size_t first) {
    const float noise = errors.noise * errors.noise, place = errors.place * errors.place,
                least = noise / (errors.angle * errors.angle);
    const float bent = 2.0f * place / (errors.angle * errors.angle);  // slopes along a contour, by errors of its places
    float variances[Look::MOST], residuals[Look::MOST], squares[Look::MOST], slope_errors[Look::MOST];
    int counts[Look::MOST];
    for (size_t i = 0; i < seen.size; i++) {
        const float slope = seen.by_x[i] * seen.by_x[i] + seen.by_y[i] * seen.by_y[i] + seen.by_z[i] * seen.by_z[i];
        variances[i] = noise + place * (1.0f + YOUNG / seen.weight[i]) * slope;
        slope_errors[i] = SMOOTH * least / seen.weight[i] + bent * slope;
        residuals[i] = contrasts[i] - seen.value[i];
        squares[i] = residuals[i] * residuals[i] / variances[i];
        counts[i] = (seen.weight[i] >= LEAST_WEIGHT) & (slope > least);
    }
    size_t n = size_;
    for (size_t i = 0; i < seen.size; i++) {  // a branch would be taken by chance
        z[n] = residuals[i], value[n] = seen.value[i], contrast[n] = contrasts[i];
        variance[n] = variances[i], square[n] = squares[i];
        by_x[n] = seen.by_x[i], by_y[n] = seen.by_y[i], by_z[n] = seen.by_z[i];
        feigned[n] = slope_errors[i];
        tile[n] = seen.tile[i], pixel[n] = int(first + i);
        n += size_t(counts[i]);
    }
    size_ = n;
}

/// Return how many times as large as their model states the residuals are, by the median of some.
float Residuals::scale() const {
    std::vector<float> some;
    for (size_t i = 0; i < size_; i += 1 + size_ / MEDIAN_OF) some.push_back(square[i]);
    const auto middle = some.begin() + nb::ssize_t(some.size() / 2);
    std::nth_element(some.begin(), middle, some.end());
    return std::max(1.4826f * std::sqrt(*middle), 0.5f);
}

/// Set the weights of residuals that are `scale` times as large as their model states.
WIDE void Residuals::weigh(float scale) {
    const float far = 1.0f / (FAR * FAR * scale * scale), by_variance = 1.0f / (scale * scale);
    for (size_t i = 0; i < size_; i++) {
        const float root = 1.0f / (1.0f + square[i] * far);
        share[i] = root * root;
        mild[i] = root * by_variance / variance[i];
        weight[i] = root * mild[i];
    }
}

/// Multiply each weight by the squared mean share of its tile.
void Residuals::weigh_tiles(std::vector<TileShare>& tiles) {
    std::fill(tiles.begin(), tiles.end(), TileShare{});
    for (size_t i = 0; i < size_; i++) tiles[size_t(tile[i])].add(share[i]);
    for (size_t i = 0; i < size_; i++) {
        const float mean = tiles[size_t(tile[i])].mean();
        share[i] *= mean * mean, weight[i] *= mean * mean;
    }
}

/// Sums over pixels, each by its weight: those of the normal equations, their number, and the moments of contrast and
/// picture. The moments have mild weights: with others, a wrong attitude correlates with what it fits by chance.
struct Sums {
    double sum[16] = {};

    Matrix<3> H() const {
        Matrix<3> r;
        r << sum[0], sum[1], sum[2], sum[1], sum[3], sum[4], sum[2], sum[4], sum[5];
        return r;
    }
    Vector<3> g() const { return {sum[6], sum[7], sum[8]}; }
    double count() const { return sum[9]; }
    double feigned() const { return sum[13]; }
    float correlation() const { return float(sum[11] / std::sqrt(std::max(sum[10] * sum[12], 1e-300))); }
};

/// Add residuals with their weights to the sums of the anchors of their tiles.
WIDE void add(const Residuals& r, const int64_t* anchor_of, Sums* by_anchor) {
    for (size_t i = 0; i < r.size(); i++) {
        const float w = r.weight[i], x = w * r.by_x[i], y = w * r.by_y[i], z = w * r.by_z[i];
        const float c = r.mild[i] * r.contrast[i], v = r.mild[i] * r.value[i];
        const float terms[16] = {x * r.by_x[i],     x * r.by_y[i],  x * r.by_z[i],  y * r.by_y[i],   y * r.by_z[i],
                                 z * r.by_z[i],     x * r.z[i],     y * r.z[i],     z * r.z[i],      r.share[i],
                                 c * r.contrast[i], c * r.value[i], v * r.value[i], w * r.feigned[i]};
        double* sum = by_anchor[anchor_of[r.tile[i]]].sum;
        for (int k = 0; k < 16; k++) sum[k] += double(terms[k]);
    }
}

/// The axes about which pixels show a rotation.
///
/// Errors of the picture have slopes too, which tell of no rotation. About an axis of symmetry the pattern has no
/// others. So an axis with less true information than errors feign is unknown (errors in variables; Fuller 1987,
/// "Measurement error models", section 2.2).
struct KnownAxes {
    Matrix<3> projection = Matrix<3>::Zero();
    Matrix<3> inverse = Matrix<3>::Zero();  // of the information, 0 about the others
    double tilt = 0.0;  // of the unknown axes, if all pixels shared an error: rotation seen by rotation about them

    KnownAxes() = default;
    KnownAxes(const Matrix<3>& H, const Matrix<3>& feigned) {
        const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> found(Eigen::Matrix3d(H - 2.0 * feigned));
        for (int i = 0; i < 3; i++) {
            const Vector<3> axis = found.eigenvectors().col(i);
            if (found.eigenvalues()(i) > 0.0) projection += axis * axis.transpose();
        }
        const Matrix<3> shown = projection * H * projection, others = Matrix<3>::Identity() - projection;
        inverse = (shown + H.trace() * others).inverse() - others / H.trace();
        tilt = std::sqrt(std::max((others * feigned).trace() * inverse.trace(), 0.0));
    }
};

struct Aligned {
    Matrix<3> R;                             // R_obj_ball
    Vector<3> dx = Vector<3>::Zero();        // the last step, in axes of the ball
    float scale = 0.0f, correlation = 0.0f;  // of residuals to their model; of contrast and picture
    KnownAxes known;                         // in axes of the ball
    int used = 0;
    bool converged = false;
};

/// Improve the attitude, and return the robust sums there by anchor.
///
/// Some samples show the way. Those that count are chosen again at each attitude: a choice at the start would take more
/// of one side of each contour, and where the picture's contrast differs from the frame's, that pulls.
Aligned align(const Samples& samples, const Picture& picture, const Errors& errors, const int64_t* anchor_of,
              const double* across, const Matrix<3>& R, std::vector<Sums>& by_anchor) {
    thread_local Pixels all, some;
    thread_local Residuals found;
    thread_local std::vector<TileShare> tiles;
    all.take(samples, STATIC_ODDS);
    found.make_room(all.size() + 1);
    std::vector<size_t> which;
    tiles.resize(size_t(6 * picture.tiles() * picture.tiles()));
    Aligned r;
    r.R = R;
    Look seen;
    if (!R.isUnitary(1e-3)) return r;  // a filter that diverges gives any matrix
    for (size_t every : {std::max<size_t>(samples.size / FEW, 1), size_t(1)}) {
        for (size_t i = 0; every > 1 && i < all.size(); i += every) which.push_back(i);
        if (every > 1) some.take(all, which);
        const Pixels& pixels = every > 1 ? some : all;
        for (int round = 0; round < MOST_ROUNDS; round++) {
            const Matrix3f towards = r.R.transpose().cast<float>();
            found.clear();
            for (size_t i = 0; i < pixels.size(); i += Look::MOST) {
                seen.at(picture, towards, &pixels.x[i], &pixels.y[i], &pixels.z[i], pixels.size() - i);
                found.add(seen, pixels.contrast.data() + i, errors, i);
            }
            r.used = int(found.size());
            r.converged = false;
            if (r.used < 10) break;
            r.scale = found.scale();
            found.weigh(r.scale);
            found.weigh_tiles(tiles);
            std::fill(by_anchor.begin(), by_anchor.end(), Sums());
            add(found, anchor_of, by_anchor.data());
            Sums whole;
            Matrix<3> feigned = Matrix<3>::Zero();
            for (size_t a = 0; a < by_anchor.size(); a++) {
                for (int k = 0; k < 16; k++) whole.sum[k] += by_anchor[a].sum[k];
                feigned += by_anchor[a].feigned() * View<3, 3>(across + 9 * a);
            }
            r.known = KnownAxes(whole.H(), feigned);
            r.dx = r.known.inverse * whole.g();
            if (!r.dx.allFinite() || !(r.known.projection.trace() > 0.5)) break;
            r.correlation = whole.correlation();
            r.R = r.R * exp(r.dx * std::min(1.0, 0.1 / r.dx.norm()));
            r.converged = r.dx.cwiseAbs().maxCoeff() < NEAR || r.dx.dot(whole.H() * r.dx) < NEAR_SQUARED;
            if (r.converged) break;
        }
    }
    return r;
}

nb::tuple align_texture(nb::tuple samples_, nb::tuple picture_, nb::handle R, double noise, double place, double pixel,
                        nb::handle anchor_of_, nb::handle across_) {
    const Samples samples = read_samples(samples_);
    const Picture picture = read_picture(picture_);
    const auto anchor_of = array<const int64_t, 6, -1, -1>(anchor_of_, "anchor_of");
    if (int(anchor_of.shape(1)) != picture.tiles() || int(anchor_of.shape(2)) != picture.tiles())
        throw nb::type_error("anchor_of: must have one element for each tile of the picture");
    const auto across = array<const double, -1, 3, 3>(across_, "across");
    const int anchors = int(across.shape(0));
    if (anchors > MOST_ANCHORS) throw nb::index_error("across: too many anchors");
    for (size_t i = 0; i < anchor_of.size(); i++)
        if (anchor_of.data()[i] < 0 || anchor_of.data()[i] >= anchors)
            throw nb::index_error("anchor_of: no such anchor");
    const Matrix<3> start = matrix<3, 3>(R, "R");
    std::vector<Sums> by_anchor(anchors);
    Aligned r;
    {
        nb::gil_scoped_release release;
        r = align(samples, picture, {float(noise), float(place), float(pixel)}, anchor_of.data(), across.data(), start,
                  by_anchor);
    }
    auto H = zeros<double>({size_t(anchors), 3, 3}), g = zeros<double>({size_t(anchors), 3});
    auto count = zeros<double>({size_t(anchors)});
    const double share_of_all = std::min(1.0, double(MOST) / double(r.used));
    for (int k = 0; r.converged && k < anchors; k++) {
        const Sums& one = by_anchor[size_t(k)];
        const Matrix<3> known = r.R * r.known.projection;
        Eigen::Map<Matrix<3>>(H.data() + 9 * k) = share_of_all * known * one.H() * known.transpose();
        // after the step
        Eigen::Map<Vector<3>>(g.data() + 3 * k) = share_of_all * known * (one.g() - one.H() * r.dx);
        count.data()[k] = share_of_all * one.count();
    }
    const Matrix<3> known = r.R * r.known.projection * r.R.transpose();
    return nb::make_tuple(to_numpy(r.R), r.scale, r.correlation, r.used, r.converged, H, g, count, to_numpy(known),
                          r.known.tilt);
}

/// The directions in which pixels see a ball whose centre is off its place, and their change by a shift.
///
/// All lengths are in radii, and all vectors in obj.
struct ShiftedBall {
    Vector3f camera;                 // from the ball's place
    Eigen::Matrix<float, 3, 2> axes;  // of the shift
    Pixels seen{};                   // with the directions, from the centre, of the places that they see
    // rad, rotations of the ball that change what a pixel sees as a shift by 1 along each axis does
    std::vector<Eigen::Matrix<float, 3, 2>> rotations{};

    /// Set the directions for a ball off its place by `shift`. In its place, the `pixels` see it in their directions.
    void move(const Pixels& pixels, const Eigen::Vector2f& shift);
};

void ShiftedBall::move(const Pixels& pixels, const Eigen::Vector2f& shift) {
    const Vector3f off = axes * shift;
    rotations.resize(pixels.size());
    for (size_t i = 0; i < pixels.size(); i++) {
        const Vector3f u(pixels.x[i], pixels.y[i], pixels.z[i]), ray = (u - camera) / (u - camera).dot(u);
        const Vector3f place = (u - off + off.dot(u) * ray).normalized();  // on the same ray
        seen.x[i] = place[0], seen.y[i] = place[1], seen.z[i] = place[2];
        for (int k = 0; k < 2; k++) rotations[i].col(k) = place.cross(axes.col(k) - axes.col(k).dot(u) * ray);
    }
}

/// The normal equations of three angles of a rotation, in axes of the ball, and of two components of a shift, radii.
struct ShiftSums {
    Matrix<5> H = Matrix<5>::Zero();
    Vector<5> g = Vector<5>::Zero();

    ShiftSums(const Residuals& r, const ShiftedBall& ball, const Matrix3f& R);
};

ShiftSums::ShiftSums(const Residuals& r, const ShiftedBall& ball, const Matrix3f& R) {
    double sum[20] = {};
    for (size_t i = 0; i < r.size(); i++) {
        const Vector3f by(r.by_x[i], r.by_y[i], r.by_z[i]);
        const Eigen::Vector2f by_shift = ball.rotations[size_t(r.pixel[i])].transpose() * (R * by);
        const float a[6] = {by[0], by[1], by[2], by_shift[0], by_shift[1], r.z[i]};
        for (int m = 0, at = 0; m < 5; m++)
            for (int n = m; n < 6; n++) sum[at++] += double(r.weight[i] * a[m] * a[n]);
    }
    for (int m = 0, at = 0; m < 5; m++) {
        for (int n = m; n < 5; n++) H(m, n) = H(n, m) = sum[at++];
        g(m) = sum[at++];
    }
    H.diagonal().array() += SINGULAR * H.trace();  // a pattern with an axis of symmetry shows no rotation about it
}

/// A shift of the ball's centre, radii, and its covariance; huge if too few pixels count.
struct Shift {
    Vector<2> place = Vector<2>::Zero();
    Matrix<2> covariance = 1e6 * Matrix<2>::Identity();
};

/// Return the shift that explains pixels together with a rotation, from the attitude that `align` found.
Shift shift_of(const Samples& samples, const Picture& picture, const Errors& errors, Matrix<3> R, ShiftedBall& ball) {
    Pixels pixels;
    pixels.take(samples, STATIC_ODDS);
    ball.seen = pixels;
    Residuals found;
    found.make_room(pixels.size() + 1);
    std::vector<TileShare> tiles(size_t(6 * picture.tiles() * picture.tiles()));
    Shift shift;
    Look seen;
    for (int round = 0; round < SHIFT_ROUNDS; round++) {
        ball.move(pixels, shift.place.cast<float>());
        const Matrix3f at = R.cast<float>(), towards = at.transpose();
        found.clear();
        for (size_t i = 0; i < pixels.size(); i += Look::MOST) {
            seen.at(picture, towards, &ball.seen.x[i], &ball.seen.y[i], &ball.seen.z[i], pixels.size() - i);
            found.add(seen, pixels.contrast.data() + i, errors, i);
        }
        if (found.size() < 10) return {};
        found.weigh(found.scale());
        found.weigh_tiles(tiles);
        const ShiftSums sums(found, ball, at);
        const Matrix<5> covariance = sums.H.inverse();
        Vector<5> dx = covariance * sums.g;
        if (!dx.allFinite()) return {};
        dx *= std::min(1.0, 0.1 / dx.norm());
        R = R * exp(Vector<3>(dx.head<3>()));
        shift.place += dx.tail<2>();
        shift.covariance = std::max(1.0, double(found.size()) / MOST) * covariance.bottomRightCorner<2, 2>();
    }
    return shift;
}

/// Return the shift, (2,) radii along `axes`, (2, 3), of the ball's centre from its place, and its covariance.
///
/// `R` is an attitude that explains the samples as far as one does. The camera's place is in radii from the ball's.
nb::tuple shift_of_texture(nb::tuple samples_, nb::tuple picture_, nb::handle R_, double noise, double place,
                           double pixel, nb::handle camera, nb::handle axes) {
    const Samples samples = read_samples(samples_);
    const Picture picture = read_picture(picture_);
    const Matrix<3> R = matrix<3, 3>(R_, "R");
    ShiftedBall ball{vector<3>(camera, "camera").cast<float>(), matrix<2, 3>(axes, "axes").transpose().cast<float>()};
    Shift shift;
    {
        nb::gil_scoped_release release;
        if (R.isUnitary(1e-3)) shift = shift_of(samples, picture, {float(noise), float(place), float(pixel)}, R, ball);
    }
    return nb::make_tuple(to_numpy(shift.place), to_numpy(shift.covariance));
}

/// Return the `most` samples of greatest contrast that may turn with the ball.
Pixels strongest(const Samples& samples, int most) {
    Pixels all, found;
    all.take(samples, STATIC_ODDS);
    std::vector<size_t> order(all.size());
    std::iota(order.begin(), order.end(), 0);
    const auto end = order.begin() + std::clamp<nb::ssize_t>(most, 0, nb::ssize_t(order.size()));
    if (end != order.end())
        std::nth_element(order.begin(), end, order.end(),
                         [&](size_t a, size_t b) { return std::abs(all.contrast[a]) > std::abs(all.contrast[b]); });
    order.erase(end, order.end());
    found.take(all, order);
    return found;
}

/// Return the correlation of frame and picture at each attitude, 0 where the picture knows less than half of it.
NewArray<double> correlate_texture(nb::tuple samples_, nb::tuple picture_, nb::handle attitudes_, int most) {
    const Samples samples = read_samples(samples_);
    const Picture picture = read_picture(picture_);
    const auto attitudes = matrices<3, 3>(attitudes_, "attitudes");
    auto result = zeros<double>({size_t(attitudes.rows())});
    nb::gil_scoped_release release;
    const Pixels pixels = strongest(samples, most);
    for (nb::ssize_t k = 0; k < attitudes.rows(); k++) {
        const Matrix3f turned = Matrix<3>(View<3, 3>(attitudes.row(k).data()).transpose()).cast<float>();
        float qq = 0.0f, mm = 0.0f, qm = 0.0f;
        size_t known = 0;
        for (size_t i = 0; i < pixels.size(); i++) {
            const Vector3f x = turned * Vector3f(pixels.x[i], pixels.y[i], pixels.z[i]);
            const Place p = place_on(x[0], x[1], x[2], picture.n);
            const size_t at =
                (size_t(p.face) * picture.n + p.row + (p.down > 0.5f)) * picture.n + p.column + (p.right > 0.5f);
            if (picture.weight[at] < LEAST_WEIGHT) continue;
            const float q = pixels.contrast[i], m = picture.value[at];
            qq += q * q;
            mm += m * m;
            qm += q * m;
            known++;
        }
        if (2 * known > pixels.size() && qq * mm > 0.0f) result.data()[k] = double(qm / std::sqrt(qq * mm));
    }
    return result;
}

}  // namespace

void bind_align(nb::module_& m) {
    m.def("align_texture", &align_texture, arg("samples"), arg("picture"), arg("R"), arg("noise"), arg("place"),
          arg("pixel"), arg("anchor_of"), arg("across"));
    m.def("shift_of_texture", &shift_of_texture, arg("samples"), arg("picture"), arg("R"), arg("noise"), arg("place"),
          arg("pixel"), arg("camera"), arg("axes"));
    m.def("correlate_texture", &correlate_texture, arg("samples"), arg("picture"), arg("attitudes"), arg("most"));
}

}  // namespace spheremouse::ball
