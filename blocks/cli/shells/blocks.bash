# bash completion of blocks: eval "$(blocks completion bash)"
_blocks() {
    local IFS=$'\n' current="${COMP_WORDS[COMP_CWORD]}" kind ending
    local -a lines
    COMPREPLY=()
    [[ $current == "=" ]] && current=""
    lines=($("$1" completion words -- "${COMP_WORDS[@]:1:COMP_CWORD}" 2>/dev/null)) || return 0
    kind="${lines[0]}"
    case "$kind" in
        files*)
            compopt -o filenames 2>/dev/null
            ending="${kind#files}"
            ending="${ending# }"
            if [[ $ending == "/" ]]; then
                COMPREPLY=($(compgen -d -- "$current"))
            elif [[ -n $ending ]]; then
                COMPREPLY=($(compgen -f -X "!*.$ending" -- "$current") $(compgen -d -- "$current"))
            else
                COMPREPLY=($(compgen -f -- "$current"))
            fi ;;
        words*)
            [[ $kind == *nospace ]] && compopt -o nospace 2>/dev/null
            COMPREPLY=("${lines[@]:1}") ;;
    esac
}
complete -F _blocks blocks
