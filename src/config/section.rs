//! One declaration per setting: what `section!` makes of it.

use toml::de::DeValue;

/// A table of settings.
pub trait Section: Default {
    /// Keys in the order of the declaration.
    const KEYS: &'static [&'static str];

    /// Sets the key from the value. The error says what the key takes.
    ///
    /// A key that is not in [`Section::KEYS`] changes nothing.
    fn set(&mut self, key: &str, value: &DeValue<'_>) -> Result<(), String>;

    /// The lines of the table in TOML: these settings of it, each after its comment.
    fn write(&self, keys: &[&str]) -> String;
}

/// Appends a setting in TOML after its comment: `lines` of documentation, then what it takes.
pub fn write_setting(text: &mut String, lines: &[&str], expected: &str, assignment: &str) {
    for line in lines {
        text.extend(["#", line, "\n"]);
    }
    text.extend(["# Takes ", expected, ".\n", assignment, "\n"]);
}

/// Declares a table of settings: `/// comment`, `key: Type = default, bounds "unit";` for each. It gives a struct with
/// these fields and its [`Section`].
macro_rules! section {
    (
        $(#[doc = $doc:literal])* $name:ident {
            $( $(#[doc = $lines:literal])* $key:ident: $type:ty = $default:expr, $bounds:expr, $unit:literal; )*
        }
    ) => {
        $(#[doc = $doc])*
        #[derive(Debug, Clone, PartialEq)]
        pub struct $name {
            $( $(#[doc = $lines])* pub $key: $type, )*
        }

        impl Default for $name {
            fn default() -> Self {
                Self { $( $key: $default, )* }
            }
        }

        impl Section for $name {
            const KEYS: &'static [&'static str] = &[ $( stringify!($key), )* ];

            fn set(&mut self, key: &str, value: &DeValue<'_>) -> Result<(), String> {
                match key {
                    $( stringify!($key) => {
                        let bounds = $bounds;
                        self.$key = <$type as Value>::read(value, &bounds)
                            .ok_or_else(|| <$type as Value>::expected(&bounds) + $unit)?;
                    } )*
                    _ => {}
                }
                Ok(())
            }

            fn write(&self, keys: &[&str]) -> String {
                let mut text = String::new();
                $(
                    if keys.contains(&stringify!($key)) {
                        let expected = <$type as Value>::expected(&$bounds) + $unit;
                        let assignment = format!("{} = {}", stringify!($key), self.$key.write());
                        write_setting(&mut text, &[ $( $lines, )* ], &expected, &assignment);
                    }
                )*
                text
            }
        }
    };
}

pub(super) use section;
