// Matrices of Eigen on arrays of NumPy, and triangular factors of covariances without variance in some direction.
#pragma once

#include <Eigen/Dense>

#include "spheremouse/native/arrays.h"

namespace spheremouse {

using Eigen::Dynamic;
template <int M, int N = M>
using Matrix = Eigen::Matrix<double, M, N, N == 1 ? Eigen::ColMajor : Eigen::RowMajor>;
template <int N>
using Vector = Matrix<N, 1>;
template <int M = Dynamic, int N = Dynamic>
using View = Eigen::Map<const Matrix<M, N>>;

/// View an argument, (m, n), as a matrix without copying. Raise a TypeError that names it if it is no such array.
template <int M = Dynamic, int N = Dynamic>
View<M, N> matrix(nb::handle given, const char* name) {
    const auto a = array<const double, M == Dynamic ? -1 : M, N == Dynamic ? -1 : N>(given, name);
    return View<M, N>(a.data(), M == Dynamic ? nb::ssize_t(a.shape(0)) : M, N == Dynamic ? nb::ssize_t(a.shape(1)) : N);
}

/// View an argument, (n,), as a vector.
template <int N = Dynamic>
Eigen::Map<const Vector<N>> vector(nb::handle given, const char* name) {
    const auto a = array<const double, N == Dynamic ? -1 : N>(given, name);
    return Eigen::Map<const Vector<N>>(a.data(), N == Dynamic ? nb::ssize_t(a.shape(0)) : N);
}

/// View an argument, (n, M, N), as one row of M * N for each of its matrices.
template <int M, int N>
View<Dynamic, M * N> matrices(nb::handle given, const char* name) {
    const auto a = array<const double, -1, M, N>(given, name);
    return View<Dynamic, M * N>(a.data(), nb::ssize_t(a.shape(0)), M * N);
}

/// Return a new array of NumPy, (m, n) or (n,), with the elements of a matrix.
template <int M, int N>
NewArray<double> to_numpy(const Matrix<M, N>& m) {
    auto a = [&] {
        if constexpr (N == 1)
            return zeros<double>({size_t(m.rows())});
        else
            return zeros<double>({size_t(m.rows()), size_t(m.cols())});
    }();
    std::copy(m.data(), m.data() + m.size(), a.data());
    return a;
}

/// A new array of NumPy, (n, M, N) or (n, M), and its matrices one by one.
template <int M, int N = 1>
struct Rows {
    NewArray<double> array;

    explicit Rows(size_t n)
        : array(N == 1 ? zeros<double>({n, size_t(M)}) : zeros<double>({n, size_t(M), size_t(N)})) {}
    Eigen::Map<Matrix<M, N>> operator[](size_t i) const {
        return Eigen::Map<Matrix<M, N>>(static_cast<double*>(array.data()) + i * M * N);
    }
};

/// Return a new array of NumPy, (n,), of whole numbers.
template <class T>
NewArray<int64_t> to_numpy(const std::vector<T>& numbers) {
    auto a = zeros<int64_t>({numbers.size()});
    std::copy(numbers.begin(), numbers.end(), a.data());
    return a;
}

/// Return the lower triangle L with L L' = C; a direction without variance gets a zero column.
template <int N>
Matrix<N> lower(const Matrix<N>& C) {
    constexpr double SINGULAR = 1e-14;  // share of a variance below which rounding errors determine it
    Matrix<N> L = Matrix<N>::Zero(C.rows(), C.cols());
    const int n = int(C.rows());
    const auto rest = [&](int i, int j) {
        double sum = C(i, j);
        for (int k = 0; k < j; k++) sum -= L(i, k) * L(j, k);
        return sum;
    };
    for (int j = 0; j < n; j++) {
        const double pivot = rest(j, j);
        if (!(pivot > SINGULAR * C(j, j))) continue;
        L(j, j) = std::sqrt(pivot);
        for (int i = j + 1; i < n; i++) L(i, j) = rest(i, j) / L(j, j);
    }
    return L;
}

/// Replace B by L^-1 B; a direction without variance gets zeros.
template <int N, class B>
void solve_lower(const Matrix<N>& L, B& b) {
    for (int i = 0; i < L.rows(); i++) {
        if (L(i, i) == 0.0) {
            b.row(i).setZero();
            continue;
        }
        for (int k = 0; k < i; k++) b.row(i) -= L(i, k) * b.row(k);
        b.row(i) /= L(i, i);
    }
}

}  // namespace spheremouse
