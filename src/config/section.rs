//! Tables of settings: the `section!` macro turns one declaration per setting into a struct and its [`Section`].

use toml::de::DeValue;

/// A table of settings.
pub trait Section {
    /// The keys in the order of their declaration.
    fn keys(&self) -> &'static [&'static str];

    /// Sets `key` to `value`. An unknown key changes nothing.
    ///
    /// # Errors
    /// Describes the values that the key takes.
    fn set(&mut self, key: &str, value: &DeValue<'_>) -> Result<(), String>;

    /// Writes the lines of the table in TOML, each setting after its comment.
    fn write(&self) -> String;

    /// The keys of the tables within this table.
    fn tables(&self) -> &'static [&'static str] {
        &[]
    }

    /// Returns the table that stands under `key`, if it is one of [`Section::tables`]. If it may stand there more than
    /// once, this adds another one.
    fn table(&mut self, _key: &str) -> Option<&mut dyn Section> {
        None
    }

    /// Writes the tables of this table, which follow all other settings. `path` is the name of this table.
    fn write_tables(&self, _path: &str) -> String {
        String::new()
    }
}

/// Appends a setting in TOML after its comment: the lines of its documentation, and the values it takes. An empty line
/// separates it from the setting before.
pub fn write_setting(text: &mut String, lines: &[&str], expected: &str, assignment: &str) {
    if !text.is_empty() {
        text.push('\n');
    }
    for line in lines {
        text.extend(["#", line, "\n"]);
    }
    text.extend(["# Takes ", expected, ".\n", assignment, "\n"]);
}

/// Declares a table of settings: `/// comment`, `key: Type = default, bounds, "unit";` for each. The macro writes a
/// struct with these fields and implements [`Section`] for it.
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
            fn keys(&self) -> &'static [&'static str] {
                &[ $( stringify!($key), )* ]
            }

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

            fn write(&self) -> String {
                let mut text = String::new();
                $(
                    let expected = <$type as Value>::expected(&$bounds) + $unit;
                    let assignment = format!("{} = {}", stringify!($key), self.$key.write());
                    write_setting(&mut text, &[ $( $lines, )* ], &expected, &assignment);
                )*
                text
            }
        }
    };
}

pub(super) use section;
