//! The table of kernels of an instruction set.

/// Makes `KERNELS` of an instruction set: the kernels of the modules beside this one, compiled for its features.
macro_rules! kernels {
    (
        $set:ty, $name:literal, vectors: $vectors:literal, tail: $tail:literal, stem_vectors: $stem:literal,
        dense_vectors: $dense:literal, dense_half: $dense_half:literal $(, features: $features:literal)?
    ) => {
        pub(super) static KERNELS: super::Kernels = super::Kernels {
            name: $name,
            lanes: $tail * <$set as InstructionSet>::LANES,
            vector: <$set as InstructionSet>::LANES,
            half: false,
            stem_panel: $stem * <$set as InstructionSet>::LANES,
            panel: $vectors * <$set as InstructionSet>::LANES,
            dense_panel: $dense * <$set as InstructionSet>::LANES,
            dense_half: $dense_half,
            // SAFETY: these kernels are handed out only on processors that have the features.
            stem: |task, output| unsafe { stem(task, output) },
            // SAFETY: as above.
            depthwise: |task, output, largest| unsafe { depthwise(task, output, largest) },
            // SAFETY: as above.
            pointwise: |task, output| unsafe { pointwise(task, output) },
            // SAFETY: as above.
            dense: |task, output| unsafe { dense(task, output) },
            // SAFETY: as above.
            peak: |rounds| unsafe { peak(rounds) },
            peak_round: PEAK_SUMS * <$set as InstructionSet>::LANES,
        };

        /// The sums that the pointwise convolution keeps in registers.
        const PEAK_SUMS: usize = $vectors * <$set as InstructionSet>::TILE;

        $(#[target_feature(enable = $features)])?
        #[inline(never)]
        unsafe fn stem(task: &super::Stem, output: &mut [f32]) {
            // SAFETY: the function is compiled for the features of the set.
            unsafe { super::stem::stem::<$set, $stem, $tail>(task, output) }
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
            unsafe { super::pointwise::pointwise::<$set, $vectors, $tail>(task, output) }
        }

        $(#[target_feature(enable = $features)])?
        #[inline(never)]
        unsafe fn dense(task: &super::Dense, output: &mut [f32]) {
            // SAFETY: the function is compiled for the features of the set.
            unsafe { super::dense::dense::<$set, $dense>(task, output) }
        }

        $(#[target_feature(enable = $features)])?
        #[inline(never)]
        unsafe fn peak(rounds: usize) -> f32 {
            // SAFETY: the function is compiled for the features of the set.
            unsafe { super::peak::peak::<$set, PEAK_SUMS>(rounds) }
        }
    };
}
pub(super) use kernels;
