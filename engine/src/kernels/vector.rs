//! The operations that the kernels need from an instruction set.

/// A vector of `f32` and the shapes of the inner loops that suit its registers.
///
/// Every function is inlined into a kernel that is compiled for the instruction set.
///
/// # Safety
/// The functions may only run on a processor that has the instruction set. Pointers must be valid for
/// [`LANES`](Self::LANES) values, or for one value in [`splat`](Self::splat); they need no alignment.
pub(super) unsafe trait InstructionSet {
    /// The vector.
    type Vector: Copy;
    /// Values of a vector.
    const LANES: usize;
    /// Pixels that are multiplied at a time.
    const TILE: usize;

    unsafe fn zero() -> Self::Vector;
    unsafe fn load(from: *const f32) -> Self::Vector;
    /// Loads a vector of half precision, in which two values take the place of one `f32`. It is called only for sets whose
    /// table has `dense_half`.
    #[inline(always)]
    unsafe fn load_half(from: *const f32) -> Self::Vector {
        // SAFETY: the caller vouches for the pointer, which is valid for more than this value.
        unsafe { Self::splat(from) }
    }
    /// Prefetches the values at an address, which may lie anywhere. The default does nothing: with AVX2, for example, whose
    /// kernels load more for each product, prefetching is slower.
    #[inline(always)]
    unsafe fn prefetch(_from: *const f32) {}
    unsafe fn store(to: *mut f32, value: Self::Vector);
    /// Stores a vector as the values from number `at` on of the operand of a pointwise convolution. The pointer to the
    /// operand must be valid for them.
    #[inline(always)]
    unsafe fn store_operand(operand: *mut f32, at: usize, value: Self::Vector) {
        // SAFETY: the caller vouches for the pointer.
        unsafe { Self::store(operand.add(at), value) }
    }
    /// One value in all lanes.
    unsafe fn splat(from: *const f32) -> Self::Vector;
    unsafe fn add(a: Self::Vector, b: Self::Vector) -> Self::Vector;
    unsafe fn mul(a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// `a * b + c`.
    unsafe fn mul_add(a: Self::Vector, b: Self::Vector, c: Self::Vector) -> Self::Vector;
    unsafe fn max(a: Self::Vector, b: Self::Vector) -> Self::Vector;
    unsafe fn min(a: Self::Vector, b: Self::Vector) -> Self::Vector;

    /// Adds the products of `P` pixels and a panel of `N` vectors of output channels to `sums`. `operand` points at the
    /// first vector of channels of these pixels; the next vector lies `plane` values further.
    ///
    /// # Safety
    /// The operand and the panel must have `depth` channels, a multiple of twice the lanes or of 16.
    #[inline(always)]
    unsafe fn product<const P: usize, const N: usize>(
        mut sums: [[Self::Vector; N]; P],
        mut operand: *const f32,
        mut panel: *const f32,
        depth: usize,
        plane: usize,
    ) -> [[Self::Vector; N]; P] {
        for _ in 0..depth / Self::LANES {
            for channel in 0..Self::LANES {
                // SAFETY: the operand and the panel go on for `depth` channels.
                unsafe {
                    let weights = consecutive::<Self, N>(panel);
                    prefetch::<Self, N>(panel);
                    for (pixel, sums) in sums.iter_mut().enumerate() {
                        let value = Self::splat(operand.add(pixel * Self::LANES + channel));
                        for (sum, weight) in sums.iter_mut().zip(weights) {
                            *sum = Self::mul_add(value, weight, *sum);
                        }
                    }
                    panel = panel.add(N * Self::LANES);
                }
            }
            // SAFETY: as above; after the last round the pointer is not read.
            operand = operand.wrapping_add(plane);
        }
        sums
    }

    /// Adds the products of one row of the windows of `P` pixels and a panel of `N` vectors to `sums`. If `SPAN` is not
    /// 0, it equals `span`, and `step` is 6: the windows of a picture of three channels with stride 2.
    ///
    /// # Safety
    /// `from` must be valid for `(P - 1) * step + span` values and three more, and `panel` for `span * N` vectors.
    #[inline(always)]
    unsafe fn window_row<const P: usize, const N: usize, const SPAN: usize>(
        sums: [[Self::Vector; N]; P],
        from: *const f32,
        panel: *const f32,
        step: usize,
        span: usize,
    ) -> [[Self::Vector; N]; P] {
        // SAFETY: the caller vouches for the pointers.
        unsafe { broadcast_row::<Self, P, N>(sums, from, panel, step, span) }
    }
}

/// How far ahead of their use weights are prefetched, in values of 4 bytes. The second cache does not hold the weights of all
/// networks, and what a processor prefetches by itself ends with a page of 1024 values. Distances of 128 to 512 make the
/// networks faster by 5 to 6 %.
const AHEAD: usize = 256;

/// Fetches the `N` vectors of weights that come [`AHEAD`] after these.
///
/// # Safety
/// The processor must have the instruction set.
#[inline(always)]
pub(super) unsafe fn prefetch<I: InstructionSet + ?Sized, const N: usize>(weights: *const f32) {
    for line in (0..N * I::LANES).step_by(16) {
        // SAFETY: the caller vouches for the instruction set.
        unsafe { I::prefetch(weights.wrapping_add(AHEAD + line)) }
    }
}

/// Loads `N` vectors that lie one after the other. This is a loop, because the compiler does not inline a closure into a
/// function that is compiled for another instruction set.
///
/// # Safety
/// The processor must have the instruction set; the pointer must be valid for all vectors.
#[inline(always)]
pub(super) unsafe fn consecutive<I: InstructionSet + ?Sized, const N: usize>(from: *const f32) -> [I::Vector; N] {
    // SAFETY: the caller vouches for both.
    unsafe {
        let mut vectors = [I::zero(); N];
        for (n, vector) in vectors.iter_mut().enumerate() {
            *vector = I::load(from.add(n * I::LANES));
        }
        vectors
    }
}

/// Loads `N` vectors of `values`, from number `at` on.
///
/// # Safety
/// The processor must have the instruction set, and `values` must contain all of them.
#[inline(always)]
pub(super) unsafe fn vectors<I: InstructionSet, const N: usize>(values: &[f32], at: usize) -> [I::Vector; N] {
    // SAFETY: the caller vouches for both.
    unsafe { consecutive::<I, N>(values.as_ptr().add(at)) }
}

/// [`InstructionSet::window_row`], one value of the window at a time.
///
/// # Safety
/// The processor must have the instruction set; the pointers must be valid as for `window_row`.
#[inline(always)]
pub(super) unsafe fn broadcast_row<I: InstructionSet + ?Sized, const P: usize, const N: usize>(
    mut sums: [[I::Vector; N]; P],
    from: *const f32,
    panel: *const f32,
    step: usize,
    span: usize,
) -> [[I::Vector; N]; P] {
    for value in 0..span {
        // SAFETY: the caller vouches for the pointers.
        unsafe {
            let weights = consecutive::<I, N>(panel.add(value * N * I::LANES));
            for (pixel, sums) in sums.iter_mut().enumerate() {
                let value = I::splat(from.add(pixel * step + value));
                for (sum, weight) in sums.iter_mut().zip(weights) {
                    *sum = I::mul_add(value, weight, *sum);
                }
            }
        }
    }
    sums
}

/// Implements the functions of [`InstructionSet`] by one intrinsic each.
#[cfg(target_arch = "x86_64")]
macro_rules! vector_functions {
    (zero: $zero:ident, load: $load:ident, half: $half:ident of $load_halves:ident, store: $store:ident,
     splat: $splat:ident, add: $add:ident, mul: $mul:ident, mul_add: $mul_add:ident, max: $max:ident,
     min: $min:ident,) => {
        #[inline(always)]
        unsafe fn zero() -> Self::Vector {
            // SAFETY: the caller vouches for the instruction set.
            unsafe { $zero() }
        }

        #[inline(always)]
        unsafe fn load(from: *const f32) -> Self::Vector {
            // SAFETY: the caller vouches for the instruction set and the pointer.
            unsafe { $load(from) }
        }

        #[inline(always)]
        unsafe fn load_half(from: *const f32) -> Self::Vector {
            // SAFETY: the caller vouches for the instruction set and the pointer.
            unsafe { $half($load_halves(from.cast())) }
        }

        #[inline(always)]
        unsafe fn store(to: *mut f32, value: Self::Vector) {
            // SAFETY: the caller vouches for the instruction set and the pointer.
            unsafe { $store(to, value) }
        }

        #[inline(always)]
        unsafe fn splat(from: *const f32) -> Self::Vector {
            // SAFETY: the caller vouches for the instruction set and the pointer.
            unsafe { $splat(*from) }
        }

        #[inline(always)]
        unsafe fn add(a: Self::Vector, b: Self::Vector) -> Self::Vector {
            // SAFETY: the caller vouches for the instruction set.
            unsafe { $add(a, b) }
        }

        #[inline(always)]
        unsafe fn mul(a: Self::Vector, b: Self::Vector) -> Self::Vector {
            // SAFETY: the caller vouches for the instruction set.
            unsafe { $mul(a, b) }
        }

        #[inline(always)]
        unsafe fn mul_add(a: Self::Vector, b: Self::Vector, c: Self::Vector) -> Self::Vector {
            // SAFETY: the caller vouches for the instruction set.
            unsafe { $mul_add(a, b, c) }
        }

        #[inline(always)]
        unsafe fn max(a: Self::Vector, b: Self::Vector) -> Self::Vector {
            // SAFETY: the caller vouches for the instruction set.
            unsafe { $max(a, b) }
        }

        #[inline(always)]
        unsafe fn min(a: Self::Vector, b: Self::Vector) -> Self::Vector {
            // SAFETY: the caller vouches for the instruction set.
            unsafe { $min(a, b) }
        }
    };
}
#[cfg(target_arch = "x86_64")]
pub(super) use vector_functions;
