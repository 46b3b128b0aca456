"""The one reader of photographs and videos."""
