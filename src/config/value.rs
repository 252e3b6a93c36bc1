//! The types of settings: how a value of each type is read, checked, described and written.

use std::{fmt, ops::RangeInclusive, path::PathBuf};

use toml::de::DeValue;

/// A type of setting.
pub trait Value: Sized {
    /// The bounds of a value.
    type Bounds;

    /// Reads a value. Returns `None` if it has another type or is out of bounds.
    fn read(value: &DeValue<'_>, bounds: &Self::Bounds) -> Option<Self>;

    /// Describes the values that [`Value::read`] takes; the text follows "give".
    fn expected(bounds: &Self::Bounds) -> String;

    /// Writes the value in TOML.
    fn write(&self) -> String;
}

/// A type with a few named values.
pub trait Choice: Copy + PartialEq + 'static {
    /// Every value with its name.
    const ALL: &'static [(&'static str, Self)];

    /// The value's name.
    fn name(self) -> &'static str {
        let named = Self::ALL.iter().find(|(_, value)| *value == self);
        named.map_or("", |(name, _)| name)
    }
}

impl<T: Choice> Value for T {
    type Bounds = ();

    fn read(value: &DeValue<'_>, (): &()) -> Option<Self> {
        let text = value.as_str()?;
        let named = Self::ALL.iter().find(|(name, _)| *name == text);
        named.map(|(_, value)| *value)
    }

    fn expected((): &()) -> String {
        let names: Vec<String> = Self::ALL.iter().map(|(name, _)| quoted(name)).collect();
        match names.as_slice() {
            [only] => only.clone(),
            _ => format!("one of {}", names.join(", ")),
        }
    }

    fn write(&self) -> String {
        quoted(self.name())
    }
}

/// Implements [`Value`] for types of whole numbers.
macro_rules! whole_number {
    ($($type:ty),*) => { $(
        impl Value for $type {
            type Bounds = RangeInclusive<$type>;

            fn read(value: &DeValue<'_>, bounds: &Self::Bounds) -> Option<Self> {
                let integer = value.as_integer()?;
                let number = Self::from_str_radix(integer.as_str(), integer.radix()).ok()?;
                bounds.contains(&number).then_some(number)
            }

            fn expected(bounds: &Self::Bounds) -> String {
                format!("a whole number from {} to {}", bounds.start(), bounds.end())
            }

            fn write(&self) -> String {
                self.to_string()
            }
        }
    )* };
}

whole_number!(u32, i32);

impl Value for bool {
    type Bounds = ();

    fn read(value: &DeValue<'_>, (): &()) -> Option<Self> {
        value.as_bool()
    }

    fn expected((): &()) -> String {
        "true or false".to_owned()
    }

    fn write(&self) -> String {
        self.to_string()
    }
}

impl Value for f32 {
    type Bounds = RangeInclusive<f32>;

    fn read(value: &DeValue<'_>, bounds: &Self::Bounds) -> Option<Self> {
        let number: Self = match value {
            DeValue::Float(float) => float.as_str().parse().ok()?,
            DeValue::Integer(integer) if integer.radix() == 10 => integer.as_str().parse().ok()?,
            _ => return None,
        };
        bounds.contains(&number).then_some(number)
    }

    fn expected(bounds: &Self::Bounds) -> String {
        format!("a number from {:?} to {:?}", bounds.start(), bounds.end())
    }

    fn write(&self) -> String {
        format!("{self:?}")
    }
}

impl Value for String {
    type Bounds = ();

    fn read(value: &DeValue<'_>, (): &()) -> Option<Self> {
        value.as_str().map(str::to_owned)
    }

    fn expected((): &()) -> String {
        "a text in quotes".to_owned()
    }

    fn write(&self) -> String {
        quoted(self)
    }
}

/// The serial port of a link.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum SerialDevice {
    /// The microcontroller board that is plugged into USB.
    Auto,
    /// A path from the root: a service has no folder that a relative path could start at.
    Path(PathBuf),
}

impl fmt::Display for SerialDevice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::Path(path) => path.display().fmt(f),
        }
    }
}

impl Value for SerialDevice {
    type Bounds = ();

    fn read(value: &DeValue<'_>, (): &()) -> Option<Self> {
        match value.as_str()? {
            "auto" => Some(Self::Auto),
            path => Some(Self::Path(path.into())).filter(|_| path.starts_with('/')),
        }
    }

    fn expected((): &()) -> String {
        "\"auto\", or a path in quotes that begins with /".to_owned()
    }

    fn write(&self) -> String {
        quoted(&self.to_string())
    }
}

/// A network address as it is written: `host:port`. The host is a name or an address; an IPv6 address has brackets.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Address(String);

impl Address {
    /// Reads an address. Returns `None` unless the text is a host, a colon and a port from 1 to 65535.
    #[must_use]
    pub fn new(text: &str) -> Option<Self> {
        let (host, port) = text.rsplit_once(':')?;
        let bracketed = host.starts_with('[') && host.ends_with(']');
        let host_good = !host.is_empty() && (bracketed || !host.contains(':'));
        let port_good = port.parse::<u16>().is_ok_and(|port| port != 0);
        (host_good && port_good).then(|| Self(text.to_owned()))
    }

    /// A port of this machine.
    pub(super) fn local(port: u16) -> Self {
        Self(format!("127.0.0.1:{port}"))
    }

    /// The address as `host:port`.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl Default for Address {
    /// The port of this machine that `facewire monitor` listens to.
    fn default() -> Self {
        Self::local(5252)
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl Value for Address {
    type Bounds = ();

    fn read(value: &DeValue<'_>, (): &()) -> Option<Self> {
        value.as_str().and_then(Self::new)
    }

    fn expected((): &()) -> String {
        "\"host:port\" with a port from 1 to 65535".to_owned()
    }

    fn write(&self) -> String {
        quoted(&self.0)
    }
}

/// Writes a text as a TOML string.
pub fn quoted(text: &str) -> String {
    toml::Value::from(text).to_string()
}
