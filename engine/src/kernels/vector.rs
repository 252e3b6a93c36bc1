//! What the kernels need of an instruction set.

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
    /// Pixels of a tile.
    const TILE: usize;

    unsafe fn zero() -> Self::Vector;
    unsafe fn load(from: *const f32) -> Self::Vector;
    unsafe fn store(to: *mut f32, value: Self::Vector);
    /// One value in all lanes.
    unsafe fn splat(from: *const f32) -> Self::Vector;
    unsafe fn add(a: Self::Vector, b: Self::Vector) -> Self::Vector;
    unsafe fn mul(a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// `a * b + c`.
    unsafe fn mul_add(a: Self::Vector, b: Self::Vector, c: Self::Vector) -> Self::Vector;
    unsafe fn max(a: Self::Vector, b: Self::Vector) -> Self::Vector;
    unsafe fn min(a: Self::Vector, b: Self::Vector) -> Self::Vector;

    /// Adds the products of `P` pixels and a panel of `N` vectors of output channels to `sums`. `operand` points at the
    /// first of the pixels in its tile.
    ///
    /// # Safety
    /// The tile and the panel must have `depth` channels, a multiple of the lanes.
    #[inline(always)]
    unsafe fn product<const P: usize, const N: usize>(
        mut sums: [[Self::Vector; N]; P],
        mut operand: *const f32,
        mut panel: *const f32,
        depth: usize,
    ) -> [[Self::Vector; N]; P] {
        for _ in 0..depth / Self::LANES {
            for channel in 0..Self::LANES {
                // SAFETY: the tile and the panel go on for `depth` channels.
                unsafe {
                    let weights: [_; N] = std::array::from_fn(|n| Self::load(panel.add(n * Self::LANES)));
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
            operand = operand.wrapping_add(Self::TILE * Self::LANES);
        }
        sums
    }
}

/// The functions of [`InstructionSet`], each by one intrinsic.
#[cfg(target_arch = "x86_64")]
macro_rules! vector_functions {
    (zero: $zero:ident, load: $load:ident, store: $store:ident, splat: $splat:ident, add: $add:ident, mul: $mul:ident,
     mul_add: $mul_add:ident, max: $max:ident, min: $min:ident,) => {
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
