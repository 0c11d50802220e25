#compdef blocks
# zsh completion of blocks: eval "$(blocks completion zsh)", after compinit
_blocks() {
    local -a lines found
    local kind ending
    lines=("${(@f)$(${words[1]} completion words -- "${(@)words[2,CURRENT]}" 2>/dev/null)}")
    kind="${lines[1]}"
    found=("${(@)lines[2,-1]}")
    case "$kind" in
        files)       _files ;;
        "files /")   _files -/ ;;
        files*)      ending="${kind#files }"; _files -g "*.$ending" ;;
        *nospace)    compadd -Q -S '' -a found ;;
        words*)      compadd -Q -a found ;;
    esac
}
compdef _blocks blocks
