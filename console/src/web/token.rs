//! Random tokens: in the address of a page that other machines can reach, and of sessions.

use std::{fmt, io};

use serde::{Deserialize, Serialize};
use subtle::ConstantTimeEq as _;

/// 128 random bits.
#[derive(Clone, Serialize, Deserialize)]
pub struct Token(String);

impl Token {
    /// Makes a new token.
    pub fn random() -> io::Result<Self> {
        let mut bytes = [0; 16];
        getrandom::fill(&mut bytes).map_err(|error| io::Error::other(error.to_string()))?;
        Ok(Self(format!("{:032x}", u128::from_ne_bytes(bytes))))
    }

    /// Compares in a time that does not depend on where the texts differ, so that nobody can guess it part by part.
    pub fn is(&self, text: &str) -> bool {
        self.0.as_bytes().ct_eq(text.as_bytes()).into()
    }
}

/// Shows the token, for the address that is printed.
impl fmt::Display for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// Hides the token.
impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Token(..)")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_token_itself_is_accepted() {
        let token = Token::random().unwrap();
        let text = token.to_string();
        assert_eq!(text.len(), 32);
        assert!(token.is(&text));
        for wrong in ["", "0", &text[1..], &format!("{text}0"), &Token::random().unwrap().to_string()] {
            assert!(!token.is(wrong), "{wrong}");
        }
    }
}
