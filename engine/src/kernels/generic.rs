//! The kernels, written once over [`InstructionSet`].

use super::vector::{InstructionSet, consecutive};
use super::{Activation, Dense, Pointwise, Stem};

/// Makes `KERNELS` of an instruction set: the functions of this module, compiled for its features.
macro_rules! kernels {
    (
        $set:ty, $name:literal, vectors: $vectors:literal, tail: $tail:literal, stem_vectors: $stem:literal,
        dense_vectors: $dense:literal $(, features: $features:literal)?
    ) => {
        pub(super) static KERNELS: super::Kernels = super::Kernels {
            name: $name,
            lanes: $tail * <$set as InstructionSet>::LANES,
            vector: <$set as InstructionSet>::LANES,
            stem_panel: $stem * <$set as InstructionSet>::LANES,
            panel: $vectors * <$set as InstructionSet>::LANES,
            dense_panel: $dense * <$set as InstructionSet>::LANES,
            // SAFETY: these kernels are handed out only on processors that have the features.
            stem: |task, output| unsafe { stem(task, output) },
            // SAFETY: as above.
            depthwise: |task, output, largest| unsafe { depthwise(task, output, largest) },
            // SAFETY: as above.
            pointwise: |task, output| unsafe { pointwise(task, output) },
            // SAFETY: as above.
            dense: |task, output| unsafe { dense(task, output) },
        };

        $(#[target_feature(enable = $features)])?
        #[inline(never)]
        unsafe fn stem(task: &super::Stem, output: &mut [f32]) {
            // SAFETY: the function is compiled for the features of the set.
            unsafe { super::generic::stem::<$set, $stem, $tail>(task, output) }
        }

        $(#[target_feature(enable = $features)])?
        #[inline(never)]
        unsafe fn depthwise(task: &super::Depthwise, output: &mut [f32], largest: &mut [f32]) {
            // SAFETY: the function is compiled for the features of the set.
            unsafe { super::depthwise::depthwise::<$set>(task, output, largest) }
        }

        $(#[target_feature(enable = $features)])?
        #[inline(never)]
        unsafe fn pointwise(task: &super::Pointwise, output: &mut [f32]) {
            // SAFETY: the function is compiled for the features of the set.
            unsafe { super::generic::pointwise::<$set, $vectors, $tail>(task, output) }
        }

        $(#[target_feature(enable = $features)])?
        #[inline(never)]
        unsafe fn dense(task: &super::Dense, output: &mut [f32]) {
            // SAFETY: the function is compiled for the features of the set.
            unsafe { super::generic::dense::<$set, $dense>(task, output) }
        }
    };
}
pub(super) use kernels;

/// What happens to a vector of sums.
#[derive(Clone, Copy)]
enum Finish<V, const N: usize> {
    None,
    Relu,
    /// All slopes are at most 1, so that the larger of a value and its product is the result.
    GentlePrelu([V; N]),
    Prelu([V; N]),
}

impl<V: Copy, const N: usize> Finish<V, N> {
    /// The activation of `N` vectors of channels from `channel` on.
    ///
    /// # Safety
    /// The processor must have the instruction set, and the slopes, if any, must reach that far.
    #[inline(always)]
    unsafe fn new<I: InstructionSet<Vector = V>>(activation: Activation, channel: usize) -> Self {
        match activation {
            Activation::None => Self::None,
            Activation::Relu => Self::Relu,
            Activation::Prelu(slopes) => {
                // SAFETY: the caller vouches for the length.
                let (slopes, all) = unsafe {
                    (slopes.get_unchecked(channel..channel + N * I::LANES), vectors::<I, N>(slopes, channel))
                };
                if slopes.iter().all(|slope| *slope <= 1.0) { Self::GentlePrelu(all) } else { Self::Prelu(all) }
            }
        }
    }

    /// Applies the activation to the sums of `P` pixels.
    ///
    /// # Safety
    /// The processor must have the instruction set.
    #[inline(always)]
    unsafe fn apply<I: InstructionSet<Vector = V>, const P: usize>(self, sums: &mut [[V; N]; P]) {
        // One loop for each activation, so that the compiler unrolls all of them and keeps the sums in registers.
        // SAFETY: the caller vouches for the instruction set.
        unsafe {
            let zero = I::zero();
            match self {
                Self::None => {}
                Self::Relu => {
                    for sum in sums.as_flattened_mut() {
                        *sum = I::max(*sum, zero);
                    }
                }
                Self::GentlePrelu(slopes) => {
                    for sums in sums {
                        for n in 0..N {
                            sums[n] = I::max(sums[n], I::mul(sums[n], slopes[n]));
                        }
                    }
                }
                Self::Prelu(slopes) => {
                    for sums in sums {
                        for n in 0..N {
                            sums[n] = I::mul_add(slopes[n], I::min(sums[n], zero), I::max(sums[n], zero));
                        }
                    }
                }
            }
        }
    }
}

/// `N` vectors from `at` on.
///
/// # Safety
/// The processor must have the instruction set, and the values must reach that far.
#[inline(always)]
pub(super) unsafe fn vectors<I: InstructionSet, const N: usize>(values: &[f32], at: usize) -> [I::Vector; N] {
    // SAFETY: the caller vouches for both.
    unsafe { consecutive::<I, N>(values.as_ptr().add(at)) }
}

fn assert_slopes(activation: Activation, channels: usize) {
    if let Activation::Prelu(slopes) = activation {
        assert!(slopes.len() >= channels, "one slope for each channel");
    }
}

/// See [`super::Kernels::pointwise`].
///
/// # Safety
/// The processor must have the instruction set.
#[inline(always)]
pub(super) unsafe fn pointwise<I: InstructionSet, const N: usize, const TAIL: usize>(
    task: &Pointwise,
    output: &mut [f32],
) {
    let &Pointwise { pixels, depth, channels, residual, residual_channels, .. } = task;
    assert!([depth, channels, residual_channels].iter().all(|count| count.is_multiple_of(TAIL * I::LANES)));
    assert!(residual_channels <= channels);
    assert!(task.operand.len() >= pixels * depth);
    assert!(task.weights.len() >= depth * channels && task.bias.len() >= channels);
    assert!(output.len() >= pixels * channels);
    assert!(residual.is_empty() || residual.len() >= pixels * residual_channels);
    assert_slopes(task.activation, channels);
    let mut channel = 0;
    // SAFETY: all sizes were checked above, and each panel lies below `channels`.
    unsafe {
        while channel + N * I::LANES <= channels {
            panel::<I, N>(task, channel, output);
            channel += N * I::LANES;
        }
        while channel < channels {
            panel::<I, TAIL>(task, channel, output);
            channel += TAIL * I::LANES;
        }
    }
}

/// Computes `N` vectors of output channels, from `channel` on, of all pixels.
///
/// # Safety
/// The processor must have the instruction set; the sizes must be those that [`pointwise`] checks.
#[inline(always)]
unsafe fn panel<I: InstructionSet, const N: usize>(task: &Pointwise, channel: usize, output: &mut [f32]) {
    let residual_vectors = if task.residual.is_empty() { 0 } else { task.residual_channels };
    // SAFETY: the caller vouches for all sizes.
    unsafe {
        let finish = Finish::<I::Vector, N>::new::<I>(task.activation, channel);
        let work = Panel {
            weights: task.weights.as_ptr().add(channel * task.depth),
            depth: task.depth,
            plane: task.pixels * I::LANES,
            bias: vectors::<I, N>(task.bias, channel),
            residual_step: task.residual_channels,
            residual_vectors: (residual_vectors.saturating_sub(channel) / I::LANES).min(N),
            finish,
            step: task.channels,
        };
        let mut operand = task.operand.as_ptr();
        let mut residual = task.residual.as_ptr().wrapping_add(channel);
        let mut output = output.as_mut_ptr().add(channel);
        let mut left = task.pixels;
        while left > 0 {
            let done = match left {
                12.. if I::TILE == 12 => work.run::<I, 12>(operand, residual, output),
                8.. if I::TILE >= 8 => work.run::<I, 8>(operand, residual, output),
                6.. if I::TILE == 6 => work.run::<I, 6>(operand, residual, output),
                4.. => work.run::<I, 4>(operand, residual, output),
                _ => work.run::<I, 1>(operand, residual, output),
            };
            operand = operand.wrapping_add(done * I::LANES);
            residual = residual.wrapping_add(done * work.residual_step);
            output = output.wrapping_add(done * work.step);
            left -= done;
        }
    }
}

/// A panel of weights, and what its sums begin with and end with.
struct Panel<V, const N: usize> {
    weights: *const f32,
    depth: usize,
    /// From a vector of channels of the operand to the next.
    plane: usize,
    bias: [V; N],
    residual_step: usize,
    /// Vectors of the panel that have a residual: the first ones.
    residual_vectors: usize,
    finish: Finish<V, N>,
    step: usize,
}

impl<V: Copy, const N: usize> Panel<V, N> {
    /// Computes `P` pixels and returns their number.
    ///
    /// # Safety
    /// The processor must have the instruction set; the pointers must be those of `P` pixels.
    #[inline(always)]
    unsafe fn run<I: InstructionSet<Vector = V>, const P: usize>(
        &self,
        operand: *const f32,
        residual: *const f32,
        output: *mut f32,
    ) -> usize {
        // SAFETY: the caller vouches for the pointers.
        unsafe {
            let mut sums = [self.bias; P];
            if self.residual_vectors == N {
                for (pixel, sums) in sums.iter_mut().enumerate() {
                    let residual = residual.add(pixel * self.residual_step);
                    for (n, sum) in sums.iter_mut().enumerate() {
                        *sum = I::add(self.bias[n], I::load(residual.add(n * I::LANES)));
                    }
                }
            } else if self.residual_vectors > 0 {
                for (pixel, sums) in sums.iter_mut().enumerate() {
                    let residual = residual.add(pixel * self.residual_step);
                    for (n, sum) in sums.iter_mut().enumerate().take(self.residual_vectors) {
                        *sum = I::add(self.bias[n], I::load(residual.add(n * I::LANES)));
                    }
                }
            }
            let mut sums = I::product::<P, N>(sums, operand, self.weights, self.depth, self.plane);
            self.finish.apply::<I, P>(&mut sums);
            for (pixel, sums) in sums.into_iter().enumerate() {
                for (n, sum) in sums.into_iter().enumerate() {
                    I::store(output.add(pixel * self.step + n * I::LANES), sum);
                }
            }
            P
        }
    }
}

/// See [`super::Kernels::stem`].
///
/// # Safety
/// The processor must have the instruction set.
#[inline(always)]
pub(super) unsafe fn stem<I: InstructionSet, const N: usize, const TAIL: usize>(task: &Stem, output: &mut [f32]) {
    let (channels, values) = (task.bias.len(), task.rows.len() * task.span);
    assert!(channels.is_multiple_of(TAIL * I::LANES) && task.weights.len() >= channels * values);
    assert!(output.len() >= task.pixels * channels && task.pixels > 0);
    assert!(task.rows.iter().all(|row| row.len() >= ((task.pixels - 1) * task.step + task.span).next_multiple_of(4)));
    assert_slopes(task.activation, channels);
    let mut channel = 0;
    // SAFETY: all sizes were checked above.
    unsafe {
        while channel + N * I::LANES <= channels {
            stem_spans::<I, N>(task, channel, output);
            channel += N * I::LANES;
        }
        while channel < channels {
            stem_spans::<I, TAIL>(task, channel, output);
            channel += TAIL * I::LANES;
        }
    }
}

/// Chooses the code for the windows of facewire's networks, or for any.
///
/// # Safety
/// As [`stem_panel`].
#[inline(always)]
unsafe fn stem_spans<I: InstructionSet, const N: usize>(task: &Stem, channel: usize, output: &mut [f32]) {
    // SAFETY: the caller vouches for all sizes.
    unsafe {
        match (task.step, task.span) {
            (6, 9) => stem_panel::<I, N, 9>(task, channel, output),
            (6, 15) => stem_panel::<I, N, 15>(task, channel, output),
            _ => stem_panel::<I, N, 0>(task, channel, output),
        }
    }
}

/// # Safety
/// The processor must have the instruction set; the sizes must be those that [`stem`] checks.
#[inline(always)]
unsafe fn stem_panel<I: InstructionSet, const N: usize, const SPAN: usize>(
    task: &Stem,
    channel: usize,
    output: &mut [f32],
) {
    let mut pixel = 0;
    // SAFETY: the caller vouches for all sizes.
    unsafe {
        let finish = Finish::<I::Vector, N>::new::<I>(task.activation, channel);
        while pixel < task.pixels {
            let output = output.as_mut_ptr().add(pixel * task.bias.len() + channel);
            let done = match task.pixels - pixel {
                12.. if I::TILE == 12 => stem_pixels::<I, 12, N, SPAN>(task, channel, pixel, finish, output),
                6.. if I::TILE == 6 => stem_pixels::<I, 6, N, SPAN>(task, channel, pixel, finish, output),
                4.. => stem_pixels::<I, 4, N, SPAN>(task, channel, pixel, finish, output),
                _ => stem_pixels::<I, 1, N, SPAN>(task, channel, pixel, finish, output),
            };
            pixel += done;
        }
    }
}

/// Computes `P` pixels and returns their number.
///
/// # Safety
/// As [`stem_panel`].
#[inline(always)]
unsafe fn stem_pixels<I: InstructionSet, const P: usize, const N: usize, const SPAN: usize>(
    task: &Stem,
    channel: usize,
    pixel: usize,
    finish: Finish<I::Vector, N>,
    output: *mut f32,
) -> usize {
    // SAFETY: the caller vouches for all sizes.
    unsafe {
        let mut sums = [vectors::<I, N>(task.bias, channel); P];
        let mut weights = task.weights.as_ptr().add(channel * task.rows.len() * task.span);
        for row in task.rows {
            sums =
                I::window_row::<P, N, SPAN>(sums, row.as_ptr().add(pixel * task.step), weights, task.step, task.span);
            weights = weights.add(task.span * N * I::LANES);
        }
        finish.apply::<I, P>(&mut sums);
        for (pixel, sums) in sums.into_iter().enumerate() {
            for (n, sum) in sums.into_iter().enumerate() {
                I::store(output.add(pixel * task.bias.len() + n * I::LANES), sum);
            }
        }
        P
    }
}

/// See [`super::Kernels::dense`].
///
/// # Safety
/// The processor must have the instruction set.
#[inline(always)]
pub(super) unsafe fn dense<I: InstructionSet, const N: usize>(task: &Dense, output: &mut [f32]) {
    let (outputs, depth) = (task.bias.len(), task.input.len());
    assert!(outputs.is_multiple_of(N * I::LANES) && output.len() >= outputs);
    assert!(task.weights.len() >= outputs * depth);
    for first in (0..outputs).step_by(N * I::LANES) {
        // SAFETY: all sizes were checked above.
        unsafe {
            let mut sums = vectors::<I, N>(task.bias, first);
            let mut weights = task.weights.as_ptr().add(first * depth);
            for value in task.input {
                let value = I::splat(value);
                for (n, sum) in sums.iter_mut().enumerate() {
                    *sum = I::mul_add(value, I::load(weights.add(n * I::LANES)), *sum);
                }
                weights = weights.add(N * I::LANES);
            }
            for (n, sum) in sums.into_iter().enumerate() {
                I::store(output.as_mut_ptr().add(first + n * I::LANES), sum);
            }
        }
    }
}
