//! Tables of settings: one `section!` makes a struct, its defaults, the reader of its table, and the comparison of two.

use toml::{Spanned, de::DeValue};

use super::{overlay::Overlay, value::Value};

/// A key of a file and its value.
pub struct Entry<'a> {
    pub key: &'a str,
    /// The key after those of the tables around it, such as `camera.width`.
    pub path: String,
    /// The byte of the file at which the key stands.
    pub start: usize,
    pub value: &'a Spanned<DeValue<'a>>,
}

impl<'a> Entry<'a> {
    /// The same key with another value.
    pub fn with(&self, value: &'a Spanned<DeValue<'a>>) -> Self {
        Self { key: self.key, path: self.path.clone(), start: self.start, value }
    }

    /// Returns each table of an array of tables, or the only one.
    pub fn each(&self) -> Vec<Self> {
        match self.value.get_ref().as_array() {
            Some(array) => array.iter().map(|value| self.with(value)).collect(),
            None => vec![self.with(self.value)],
        }
    }
}

/// What can stand under a key: a value, a table, or an array of tables.
pub trait Setting {
    /// The bounds of a value.
    type Bounds;

    /// Takes the value of the entry, or adds a fault to those of the file.
    fn set(&mut self, entry: &Entry<'_>, bounds: &Self::Bounds, unit: &str, file: &mut Overlay<'_>);
}

impl<T: Value> Setting for T {
    type Bounds = T::Bounds;

    fn set(&mut self, entry: &Entry<'_>, bounds: &Self::Bounds, unit: &str, file: &mut Overlay<'_>) {
        match T::read(entry.value.get_ref(), bounds) {
            Some(value) => *self = value,
            None => file.refuse(entry, T::expected(bounds) + unit),
        }
    }
}

/// A table of settings.
pub trait Section {
    fn keys(&self) -> Vec<&'static str>;

    /// Sets one of the keys.
    fn set_key(&mut self, entry: &Entry<'_>, file: &mut Overlay<'_>);

    /// Says why a key that the section does not have is none, if there is more to say than which key is similar.
    fn objection(&self, _key: &str) -> Option<String> {
        None
    }
}

/// Lets a section stand under a key.
macro_rules! table {
    ($type:ty) => {
        impl $crate::config::section::Setting for $type {
            type Bounds = ();

            fn set(&mut self, entry: &Entry<'_>, (): &(), _: &str, file: &mut Overlay<'_>) {
                file.section(self, entry);
            }
        }
    };
}

/// The key of a field: its name, unless another one is given.
macro_rules! key {
    ($field:ident) => {
        stringify!($field)
    };
    ($field:ident $key:literal) => {
        $key
    };
}

/// Declares a table of settings: `field: Type = default, bounds, "unit";` for each. Values without bounds have no unit
/// either. `field "key": ...` gives a field another key than its name. With `impl Type`, the struct and its defaults are
/// those of another module.
macro_rules! section {
    (
        $name:ident {
            $( $field:ident $($key:literal)?: $type:ty = $default:expr $(, $bounds:expr, $unit:literal)?; )*
        }
    ) => {
        #[derive(Debug, Clone, PartialEq)]
        pub struct $name {
            $( pub $field: $type, )*
        }

        impl Default for $name {
            fn default() -> Self {
                Self { $( $field: $default, )* }
            }
        }

        impl $name {
            /// The keys whose values differ from those of `other`.
            pub fn changed_keys(&self, other: &Self) -> Vec<&'static str> {
                let keys = [ $( (key!($field $($key)?), self.$field != other.$field), )* ];
                keys.into_iter().filter(|(_, is_changed)| *is_changed).map(|(key, _)| key).collect()
            }
        }

        section! { impl $name { $( $field $($key)?: $type $(, $bounds, $unit)?; )* } }
    };
    (impl $name:ty { $( $field:ident $($key:literal)?: $type:ty $(, $bounds:expr, $unit:literal)?; )* }) => {
        impl Section for $name {
            fn keys(&self) -> Vec<&'static str> {
                vec![ $( key!($field $($key)?), )* ]
            }

            fn set_key(&mut self, entry: &Entry<'_>, file: &mut Overlay<'_>) {
                match entry.key {
                    $( key!($field $($key)?) => {
                        let (_bounds, _unit) = ((), "");
                        $( let (_bounds, _unit) = ($bounds, $unit); )?
                        <$type as $crate::config::section::Setting>::set(&mut self.$field, entry, &_bounds, _unit, file);
                    } )*
                    _ => {}
                }
            }
        }

        table!($name);
    };
}

pub(super) use {key, section, table};
