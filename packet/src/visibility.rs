//! How much of each part of the face is in view.

/// Below this, a part counts as covered: less than half of it is in view.
const COVERED: f32 = 0.5;

/// Declares [`Visibility`] from the list of its parts.
macro_rules! visibility {
    ($($(#[doc = $doc:literal])* $part:ident)*) => {
        /// How much of each part of the face is in view, from 0 (covered) to 1. Left and right are the person's own.
        ///
        /// A headset, a mask, a hand or sunglasses cover parts of a face. The coefficients of a covered part are a guess.
        #[derive(Debug, Clone, Copy, PartialEq)]
        pub struct Visibility {
            $($(#[doc = $doc])* pub $part: f32,)*
        }

        impl Visibility {
            /// The whole face is in view, or it is not known that a part of it is covered.
            pub const WHOLE: Self = Self { $($part: 1.0,)* };

            /// The names of the parts. All lists of parts have this order.
            pub const NAMES: [&str; PARTS] = [$(stringify!($part),)*];

            /// Returns the values of the parts.
            #[must_use]
            pub const fn values(&self) -> [f32; PARTS] {
                [$(self.$part,)*]
            }

            /// Returns the visibility with these values of the parts.
            #[must_use]
            pub const fn from_values(values: [f32; PARTS]) -> Self {
                let [$($part,)*] = values;
                Self { $($part,)* }
            }
        }

        const PARTS: usize = [$(stringify!($part),)*].len();
    };
}

visibility! {
    /// The left eye with its lids.
    left_eye
    /// The right eye with its lids.
    right_eye
    /// Both brows.
    brows
    /// Mouth and jaw.
    mouth
    /// Cheeks and nose.
    cheeks
    /// The whole face.
    face
}

impl Visibility {
    /// Returns the names and values of the parts.
    pub fn parts(&self) -> impl Iterator<Item = (&'static str, f32)> + Clone {
        Self::NAMES.into_iter().zip(self.values())
    }

    /// Returns the names of the parts that are covered, of which less than half is in view.
    pub fn covered(&self) -> impl Iterator<Item = &'static str> + Clone {
        self.parts().filter(|(_, value)| *value < COVERED).map(|(name, _)| name)
    }

    /// Returns the visibility of the mirror image, whose left eye is the right one.
    #[must_use]
    pub const fn mirrored(self) -> Self {
        Self { left_eye: self.right_eye, right_eye: self.left_eye, ..self }
    }
}

impl Default for Visibility {
    fn default() -> Self {
        Self::WHOLE
    }
}
